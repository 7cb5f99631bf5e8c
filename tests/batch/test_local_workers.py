"""Processes that stay warm, die, and are asked to end."""

import os
import time

import pytest

from gscomplete.batch import local_workers
from gscomplete.batch.local_workers import run_local
from gscomplete.batch.machine import GIB, WorkerPlan
from gscomplete.errors import UserError
from tests.builders import batch_jobs


def workers(count: int, memory_bytes: int = 8 * GIB) -> WorkerPlan:
    return WorkerPlan(count, 3, memory_bytes)


def test_workers_stay_from_task_to_task_with_their_share_of_threads():
    done = list(run_local(batch_jobs.process_and_threads, range(12), workers(2)))
    assert sorted(each.task for each in done) == list(range(12))
    processes = {each.result[0] for each in done}
    assert len(processes) == 2
    assert os.getpid() not in processes
    assert {each.result[1] for each in done} == {"3"}
    assert os.environ.get("OMP_NUM_THREADS") != "3"


def test_a_killed_worker_takes_only_its_own_task_with_it(tmp_path):
    tasks = [tmp_path / str(number) for number in range(4)]
    done = list(run_local(batch_jobs.die_unless_noted, tasks, workers(2)))
    assert sorted(each.result for each in done) == ["0", "1", "2", "3"]
    assert {each.attempts for each in done} == {2}


def test_a_task_that_kills_every_worker_is_given_up():
    done = list(run_local(batch_jobs.die, [1], workers(1), retries=1))
    assert [(each.task, each.result, each.attempts) for each in done] == [(1, None, 2)]


def test_an_error_of_a_task_ends_all():
    with pytest.raises(UserError, match="nothing can be done"):
        list(run_local(batch_jobs.fail, range(100), workers(2)))


def test_a_worker_takes_no_more_memory_than_it_may():
    with pytest.raises(MemoryError):
        list(run_local(batch_jobs.allocate, [2], workers(1, memory_bytes=GIB)))


def test_no_worker_starts_without_memory(monkeypatch):
    monkeypatch.setattr(local_workers, "available_bytes", lambda: GIB)
    with pytest.raises(UserError, match=r"needs 8.0 GiB .* found 1.0 GiB free"):
        list(run_local(batch_jobs.square, [1], workers(1)))


def test_a_batch_that_is_broken_off_lets_tasks_write_checkpoints(tmp_path):
    def stop_once_both_are_at_work(running):
        if len(list(tmp_path.iterdir())) == 2:
            raise KeyboardInterrupt

    tasks = [tmp_path, tmp_path]
    with pytest.raises(KeyboardInterrupt):
        list(
            run_local(
                batch_jobs.wait_for_a_signal, tasks, workers(2), on_tick=stop_once_both_are_at_work
            )
        )
    assert (tmp_path / "checkpoint").exists()
    processes = [int(path.name) for path in tmp_path.iterdir() if path.name.isdigit()]
    assert len(processes) == 2
    deadline = time.monotonic() + 10
    while any(is_alive(process) for process in processes) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(is_alive(process) for process in processes)


def is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True
