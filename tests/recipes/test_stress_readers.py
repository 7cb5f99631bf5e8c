"""A few of the fuzzer's mutations; ``python -m recipes.stress_readers`` runs thousands."""

import logging
from pathlib import Path

import pytest

from recipes.stress_readers.mutations import mutate
from recipes.stress_readers.seeds import seed_files
from recipes.stress_readers.worker import try_reader


def test_mutated_files_are_read_or_refused(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for module in ("laspy", "gsply", "yaml"):
        pytest.importorskip(module)
    caplog.set_level(logging.CRITICAL)
    (tmp_path / "seeds").mkdir()
    (tmp_path / "mutated").mkdir()
    seeds = seed_files(tmp_path / "seeds")
    answers = []
    for number in range(150):
        path, reader = seeds[number % len(seeds)]
        damaged = tmp_path / "mutated" / path.name
        damaged.write_bytes(mutate(path.read_bytes(), 1, number))
        answers.append(f"{path.name}: {try_reader(reader, damaged, 20)}")
    odd = [a for a in answers if not a.endswith((": read", ": refused"))]
    assert odd == []
    assert sum(a.endswith(": refused") for a in answers) > 30
    assert mutate(b"abcdef", 0, 3) == mutate(b"abcdef", 0, 3)
