"""Stages count their own time, and nothing outside a profile."""

import threading
import time

import pytest

from gscomplete.util.stages import current_profile, profiled, stage


def test_a_stage_within_another_is_not_counted_twice():
    with profiled() as profile:
        with stage("outer"):
            time.sleep(0.02)
            with stage("inner"):
                time.sleep(0.05)
            time.sleep(0.02)
        with stage("inner"):
            time.sleep(0.05)
    costs = profile.costs
    assert list(costs) == ["outer", "inner"]
    assert costs["inner"].times == 2
    # Sleeps never end early; a busy machine lets them end late, but not by ten times.
    assert 0.04 <= costs["outer"].wall_s < 0.4
    assert 0.1 <= costs["inner"].wall_s < 1.0
    assert 0 <= costs["inner"].cpu_s < 0.05
    assert costs["outer"].peak_bytes > 1 << 20
    assert profile.to_json()["inner"]["times"] == 2
    assert [line.split()[0] for line in profile.lines()] == ["stage", "outer", "inner", "sum"]


def test_a_stage_that_fails_is_left():
    with profiled() as profile:
        with pytest.raises(RuntimeError), stage("one"):
            raise RuntimeError
        with stage("two"):
            pass
    assert [cost.times for cost in profile.costs.values()] == [1, 1]


def test_nothing_is_recorded_outside_a_profile_or_in_another_thread():
    with stage("alone"):
        assert current_profile() is None
    with profiled() as profile:
        thread = threading.Thread(target=lambda: stage("elsewhere").__enter__())
        thread.start()
        thread.join()
    assert not profile.costs
    assert current_profile() is None
