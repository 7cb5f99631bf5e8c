"""Recipes tell users what is wrong in one line, and their help says what they are for."""

import importlib
import os
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import recipes
from tests.builders.commands import PATIENCE_S

ROOT = Path(__file__).resolve().parents[2]


def started(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", *arguments],
        cwd=ROOT,
        env={**os.environ, "COLUMNS": "100"},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )


@pytest.mark.parametrize(
    ("recipe", "named"),
    [
        (["recipes.benchmarks.formats.ply_io", "--folder", "nowhere"], "nowhere"),
        (["recipes.benchmarks.multiview", "--images", "nowhere"], "nowhere"),
        (["recipes.real_objects.complete", "--data", "nowhere", "--out", "{out}"], "nowhere"),
    ],
)
def test_wrong_input_is_one_line(tmp_path: Path, recipe: list[str], named: str) -> None:
    done = started(*(word.format(out=tmp_path / "out") for word in recipe))
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    message = done.stderr.strip().splitlines()[-1]
    assert message.startswith(f"{recipe[0]}: error: ")
    assert named in message


def test_help_begins_with_what_the_recipe_is_for() -> None:
    done = started("recipes.benchmarks.formats.ply_io", "--help")
    assert done.returncode == 0
    assert "PLY" in done.stdout.split("options")[0]


def test_every_module_of_the_recipes_finds_what_it_uses() -> None:
    pytest.importorskip("diffusers")
    names = [found.name for found in pkgutil.walk_packages(recipes.__path__, "recipes.")]
    assert "recipes.real_objects.validation" in names
    for name in names:
        importlib.import_module(name)
