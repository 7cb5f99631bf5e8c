"""Commands and recipes as processes: what is set before PyTorch, and readers that go away."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SAMPLE = Path(__file__).resolve().parents[2] / "recipes/demo/partial.ply"
SPY = """
import importlib.abc, os, sys
class Spy(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == "torch":
            print(os.environ.get("OMP_WAIT_POLICY"), os.environ.get("GOMP_SPINCOUNT"))
            sys.meta_path.remove(self)
        return None
sys.meta_path.insert(0, Spy())
import {module}
import torch
"""


def without_settings() -> dict[str, str]:
    names = ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT", "PYTHONUNBUFFERED")
    return {name: value for name, value in os.environ.items() if name not in names}


@pytest.mark.parametrize(
    "module",
    ["gscomplete.cli.program", "splatcomplete_data.cli.program", "recipes.benchmarks.renderer"],
)
def test_threads_are_told_to_sleep_before_the_openmp_runtime_is_loaded(module: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", SPY.format(module=module)],
        env=without_settings(),
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == ["PASSIVE", "3000"]


@pytest.mark.parametrize(
    "words", [["validate", str(SAMPLE)], ["validate", str(SAMPLE), "--json"], ["--version"]]
)
def test_a_reader_that_has_gone_is_no_error_of_the_file(words: list[str]) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [sys.executable, "-m", "gscomplete.cli", *words],
        env=without_settings(),
        stdout=writing,
        stderr=subprocess.PIPE,
        text=True,
    )
    os.close(writing)
    assert (done.returncode, done.stderr) == (141, "")
