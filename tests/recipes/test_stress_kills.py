"""The killer of jobs, on jobs of a shell that take no time: sound ones, and one of every fault."""

import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gscomplete.errors import UserError
from recipes.stress_kills.disk import SmallDisk
from recipes.stress_kills.jobs import Job
from recipes.stress_kills.killing import kill_often, run_undisturbed

SOUND = 'mkdir -p "$0"; sleep 0.06; echo all > "$0/.new"; sleep 0.06; mv "$0/.new" "$0/result"'


def shell_job(script: str, resumed: str | None = None) -> Job:
    def words(text: str):
        return lambda out: ["sh", "-c", text, out]

    proceed = None if resumed is None else words(resumed)
    return Job("toy", words(script), ("result",), proceed, ".begun")


def test_a_sound_job_is_killed_and_loses_nothing(tmp_path: Path) -> None:
    job = shell_job(SOUND)
    reference = run_undisturbed(job, tmp_path / "undisturbed")
    tally = kill_often(job, reference, tmp_path, 6, 0)
    assert tally.faults == []
    assert tally.kills == 6
    assert len(tally.ends) > 1


@pytest.mark.parametrize(
    ("script", "resumed", "fault"),
    [
        ('mkdir -p "$0"; echo a > "$0/result"; sleep 0.1; echo all > "$0/result"', None, "differs"),
        (SOUND.replace("sleep", 'touch "$0/.begun"; sleep', 1), "true", "is missing"),
        (SOUND, None, "exit code 70"),
    ],
)
def test_faults_are_found(tmp_path: Path, script: str, resumed: str | None, fault: str) -> None:
    job = shell_job(script, resumed)
    reference = run_undisturbed(job, tmp_path / "undisturbed")
    if "70" in fault:
        job = shell_job("echo internal error >&2; exit 70")
    tally = kill_often(job, reference, tmp_path, 6, 0)
    assert any(fault in found for found in tally.faults), tally.faults


def test_only_a_small_disk_is_filled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def disk_of(size: int) -> None:
        used = sum(path.stat().st_size for path in tmp_path.iterdir())
        free = max(0, size - used) // 512
        status = SimpleNamespace(f_blocks=size // 512, f_frsize=512, f_bavail=free)
        monkeypatch.setattr(os, "statvfs", lambda folder: status)

    disk_of(2**40)
    with pytest.raises(UserError, match="at most 1 GB"):
        SmallDisk(tmp_path)
    size = 4 * 2**20
    real = os.write

    def write(handle: int, data: bytes) -> int:
        count = real(handle, data)
        disk_of(size)
        return count

    disk_of(size)
    disk = SmallDisk(tmp_path)
    monkeypatch.setattr(os, "write", write)
    with disk.nearly_full(np.random.default_rng(0)):
        filled = (tmp_path / "ballast").stat().st_size
        assert size - 2**19 <= filled <= size
    assert not (tmp_path / "ballast").exists()
