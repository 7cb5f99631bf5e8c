"""The same bytes with any number of threads, in processes that are told it as users tell it."""

import os
import subprocess
import sys

from tests.builders.commands import PATIENCE_S, REPOSITORY, SAMPLE

SCRIPT = """
from gscomplete.cli.guard import let_threads_sleep

let_threads_sleep()
import dataclasses, hashlib, sys, gscomplete
from gscomplete.completion.presets import preset
prior = gscomplete.load_prior("embedded")
settings = dataclasses.replace(preset("distill", prior), steps=1)
result = gscomplete.complete(sys.argv[1], "a red mug", prior=prior, settings=settings)
bits = b"".join(value.numpy().tobytes() for _, value in result.new_in_file.fields())
print(len(result.new), hashlib.sha256(bits).hexdigest())
"""


def test_bytes_do_not_depend_on_the_number_of_threads():
    """``distill`` has all stages of the default, and a step; 5 divides no side of a grid."""
    results = {threads: run(threads) for threads in (1, 5)}
    assert int(results[1].split()[0]) > 1000
    assert results[1] == results[5]


def run(threads: int) -> str:
    count = {"OMP_NUM_THREADS": str(threads), "NUMBA_NUM_THREADS": str(threads)}
    result = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(SAMPLE)],
        capture_output=True, text=True, timeout=PATIENCE_S, cwd=REPOSITORY, env=os.environ | count,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    return result.stdout
