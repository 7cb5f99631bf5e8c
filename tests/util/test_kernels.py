import multiprocessing
import os
import sys
import threading

import numba
import numpy as np
import pytest

from gscomplete.util import kernels
from gscomplete.util.kernels import (
    HELPER,
    KERNEL,
    KernelTypes,
    compilations_told,
    run_kernel,
    share_out,
)
from gscomplete.util.stages import profiled
from tests.builders.commands import PATIENCE_S


@pytest.mark.parametrize(("count", "threads"), [(0, 2), (1, 4), (7, 1), (100, 3)])
def test_every_task_is_done_once(count, threads):
    done = np.zeros(count, np.int64)

    def work(number):
        done[number] += 1

    share_out(work, count, threads)
    assert (done == 1).all()


def test_threads_work_at_the_same_time():
    """Both tasks wait for each other."""
    meeting = threading.Barrier(2)
    share_out(lambda number: meeting.wait(timeout=PATIENCE_S), 2, 2)


def test_the_first_failure_is_raised_after_all_have_ended():
    running = []

    def work(number):
        running.append(number)
        if number in (3, 5):
            raise ValueError(number)
        running.remove(number)

    with pytest.raises(ValueError, match="3"):
        share_out(work, 6, 1)
    assert running == [3]  # what comes after a failure is left
    share_out(lambda number: None, 6, 2)  # the helpers are still there


def _sum_in_child(found):
    counts = np.zeros(64)
    share_out(lambda number: counts.__setitem__(number, 1), 64, 2)
    found.put(counts.sum())


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no fork")
@pytest.mark.filterwarnings("ignore:This process.*is multi-threaded:DeprecationWarning")
def test_a_forked_process_has_helpers_of_its_own():
    share_out(lambda number: None, 2, 2)
    context = multiprocessing.get_context("fork")
    found = context.SimpleQueue()
    child = context.Process(target=_sum_in_child, args=(found,))
    child.start()
    child.join(timeout=PATIENCE_S)
    assert child.exitcode == 0
    assert found.get() == 64


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("count", [0, 1, 9, 1000])
def test_runs_are_all_tasks(count, threads):
    runs = []

    def kernel(first, last, name):
        assert name == "argument"
        runs.append((first, last))

    if threads > numba.config.NUMBA_NUM_THREADS:
        pytest.skip("numba was started with one thread")
    before = numba.get_num_threads()
    numba.set_num_threads(threads)
    run_kernel(kernel, count, 10, "argument")
    numba.set_num_threads(before)
    covered = [k for run in sorted(runs) for k in range(*run)]
    assert covered == list(range(count))
    assert len(runs) == 1 or len(runs) <= count / 10


def _made():
    """Return a kernel that calls another one, neither compiled yet nor kept on the disk."""

    @numba.njit(**HELPER)
    def doubled(value):
        return 2 * value

    @numba.njit(**KERNEL | {"cache": False})
    def kernel(values):
        for i in range(len(values)):
            values[i] = doubled(values[i])

    return kernel


def test_compiling_is_told_once_and_counted_as_a_stage():
    told, values = [], np.ones(3)
    first, second = _made(), _made()
    with profiled() as profile, compilations_told(lambda: told.append("told")):
        first(values)
        first(values)
        second(values)
    assert (values == 8).all()
    assert told == ["told"]
    assert profile.costs["compile"].times == 2
    assert profile.costs["compile"].wall_s > 0
    _made()(values)
    assert told == ["told"]


def test_a_kernel_that_threads_share_is_compiled_by_the_calling_one():
    """A profile belongs to a thread; what others compile it does not see."""

    @numba.njit(nogil=True)
    def kernel(first, last, values):
        for k in range(first, last):
            values[k] += 1

    values = np.zeros(64)
    with profiled() as profile, compilations_told(lambda: None):
        run_kernel(kernel, 64, 1, values)
    assert (values == 1).all()
    assert profile.costs["compile"].times == 1


def test_what_is_compiled_is_not_told_of():
    kernel, told = _made(), []
    kernel(np.ones(3))
    with compilations_told(lambda: told.append("told")):
        kernel(np.ones(3))
    assert told == []


_TABLE = (KernelTypes("gscomplete.render.cpu.merge", "count_in_front", "(u8[::1], u8[::1])"),)


@pytest.fixture
def two_cores(monkeypatch):
    if sys.platform != "linux":
        pytest.skip("forks on Linux only")
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 1})


def test_kernels_that_are_missing_are_compiled_by_another_process(
    two_cores, monkeypatch, tmp_path, capfd
):
    def compile_kernels(kernels):
        os.write(1, b"of no interest to who reads the run's output")
        (tmp_path / "process").write_text(str(os.getpid()))

    monkeypatch.setattr(kernels, "is_kept", lambda kernel: False)
    monkeypatch.setattr(kernels, "compile_kernels", compile_kernels)
    process = kernels.compile_beside(_TABLE)
    assert process is not None
    assert os.waitpid(process, 0)[1] == 0
    assert (tmp_path / "process").read_text() == str(process)
    assert capfd.readouterr().out == ""


def test_an_error_stays_in_that_process(two_cores, monkeypatch, capfd):
    def compile_kernels(kernels):
        raise OSError("no space left on device")

    monkeypatch.setattr(kernels, "is_kept", lambda kernel: False)
    monkeypatch.setattr(kernels, "compile_kernels", compile_kernels)
    process = kernels.compile_beside(_TABLE)
    assert process is not None
    assert os.waitpid(process, 0)[1] == 0
    assert capfd.readouterr() == ("", "")


def test_no_process_where_kernels_are_kept_or_one_core_is_all(two_cores, monkeypatch):
    monkeypatch.setattr(kernels, "is_kept", lambda kernel: True)
    assert kernels.compile_beside(_TABLE) is None
    monkeypatch.setattr(kernels, "is_kept", lambda kernel: False)
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0})
    assert kernels.compile_beside(_TABLE) is None
