import pytest

from gscomplete.batch import machine
from gscomplete.batch.machine import GIB, available_bytes, plan_workers, visible_gpus
from gscomplete.errors import UserError


@pytest.fixture(autouse=True)
def eight_cores(monkeypatch):
    monkeypatch.setattr(machine, "usable_cores", lambda: 8)
    monkeypatch.setattr(machine, "available_bytes", lambda: 10 * GIB)


def planned(items: int = 100, memory_gib: float = 1.0, **more) -> tuple[int, int]:
    workers = plan_workers(items, memory_bytes=int(memory_gib * GIB), **more)
    return workers.count, workers.threads


def test_workers_fill_the_cores_and_never_more():
    assert planned() == (8, 1)
    assert planned(items=2) == (2, 4)
    assert planned(items=3) == (3, 2)
    assert planned(threads=4) == (2, 4)
    assert planned(count=3) == (3, 2)


def test_memory_bounds_their_number():
    assert planned(memory_gib=4) == (2, 4)
    with pytest.raises(UserError, match=r"expected 16.0 GiB of memory .* found 10.0 GiB free"):
        planned(memory_gib=16)
    with pytest.raises(UserError, match="--workers 4"):
        planned(memory_gib=4, count=4)


def test_each_gpu_has_a_worker_that_sees_no_other():
    workers = plan_workers(100, memory_bytes=GIB, gpus=("2", "5"))
    assert (workers.count, workers.threads) == (2, 4)
    seen = [workers.environment(number)["CUDA_VISIBLE_DEVICES"] for number in (0, 1)]
    assert seen == ["2", "5"]


def test_free_memory_is_what_the_control_group_leaves(tmp_path):
    (tmp_path / "meminfo").write_text("MemTotal: 9 kB\nMemAvailable:    8000000 kB\n")
    assert available_bytes(tmp_path, tmp_path) == 8000000 * 1024
    (tmp_path / "memory.max").write_text("3000000000\n")
    (tmp_path / "memory.current").write_text("2000000000\n")
    (tmp_path / "memory.stat").write_text("anon 5\ninactive_file 500000000\n")
    assert available_bytes(tmp_path, tmp_path) == 1_500_000_000
    (tmp_path / "memory.max").write_text("max\n")
    assert available_bytes(tmp_path, tmp_path) == 8000000 * 1024
    assert available_bytes(tmp_path / "none", tmp_path / "none") is None


def test_gpus_are_those_that_cuda_would_use(tmp_path, monkeypatch):
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    assert visible_gpus(tmp_path / "none") == ()
    (tmp_path / "0000:01").mkdir()
    (tmp_path / "0000:02").mkdir()
    assert visible_gpus(tmp_path) == ("0", "1")
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "3,7")
    assert visible_gpus(tmp_path) == ("3", "7")
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    assert visible_gpus(tmp_path) == ()
