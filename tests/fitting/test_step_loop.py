import json
from dataclasses import dataclass

import pytest
import torch

from gscomplete.errors import UserError
from gscomplete.fitting.checkpoint import load_checkpoint
from gscomplete.fitting.step_loop import (
    CHECKPOINTS,
    LOG_FILE,
    logged_seconds,
    require_same_identity,
    run_steps,
)
from gscomplete.util.jsonio import write_json


@dataclass(frozen=True)
class Count:
    step: int


class Counting:
    """Counts to a number; may be interrupted in a step, before or while its state changes."""

    def __init__(self, to: int, interrupted_in: int | None = None, *, updating: bool = False):
        self.step_number, self.between_updates = 0, True
        self._to, self._interrupted_in, self._updating = to, interrupted_in, updating

    @property
    def finished(self) -> bool:
        return self.step_number >= self._to

    def step(self) -> Count:
        if self.step_number == self._interrupted_in:
            self.between_updates = not self._updating
            raise KeyboardInterrupt
        self.step_number += 1
        return Count(self.step_number - 1)

    def state(self) -> dict[str, torch.Tensor]:
        return {"step": torch.tensor(self.step_number)}


def last_step(folder) -> int:
    state = load_checkpoint(folder / CHECKPOINTS)
    assert state is not None
    return int(state["step"])


def logged(folder) -> list[int]:
    return [json.loads(line)["step"] for line in (folder / LOG_FILE).read_text().splitlines()]


def test_every_step_is_logged_and_told_of(tmp_path):
    told: list[Count] = []
    run_steps(Counting(5), tmp_path, 2, told.append)
    assert told == [Count(k) for k in range(5)]
    assert logged(tmp_path) == list(range(5))
    assert last_step(tmp_path) == 5


@pytest.mark.parametrize(("updating", "kept"), [(False, 3), (True, 2)])
def test_an_interrupted_job_goes_on_from_a_state_that_is_whole(tmp_path, updating, kept):
    with pytest.raises(KeyboardInterrupt):
        run_steps(Counting(5, 3, updating=updating), tmp_path, 2, lambda _: None)
    assert last_step(tmp_path) == kept
    again = Counting(5)
    again.step_number = kept
    run_steps(again, tmp_path, 2, lambda _: None)
    assert logged(tmp_path) == list(range(5))  # none twice


def test_the_log_tells_how_long_the_steps_took(tmp_path):
    path = tmp_path / LOG_FILE
    assert logged_seconds(path, 9) == 0
    path.write_text(
        '{"seconds": 1.5}\n{"seconds": 0.25}\nnot JSON\n{"seconds": null}\n{"seconds": 4}\n'
    )
    assert logged_seconds(path, 4) == 1.75
    assert logged_seconds(path, 1) == 1.5


def test_without_checkpoints_the_end_is_kept(tmp_path):
    run_steps(Counting(3), tmp_path, 0, lambda _: None)
    assert last_step(tmp_path) == 3


def test_what_decides_the_result_may_not_change(tmp_path):
    path = tmp_path / "run.json"
    identity = {"prompt": "a mug", "settings": {"seed": 0, "steps": 3}}
    write_json(path, {"identity": identity})
    require_same_identity(path, identity)
    with pytest.raises(UserError, match=r"run\.json: .* another prompt: .*'a mug', .* 'a cup'"):
        require_same_identity(path, {**identity, "prompt": "a cup"})
    with pytest.raises(UserError, match=r"another settings: seed: the run has 0, asked for 5;"):
        require_same_identity(path, {**identity, "settings": {"seed": 5, "steps": 3}})
    stages = {**identity, "settings": {"seed": 0, "steps": 3, "stages": list(range(100))}}
    with pytest.raises(
        UserError, match=r"stages: .* \[0, 1, 2,.*\.\.\.; resume with the options"
    ) as error:
        require_same_identity(path, stages)
    assert len(str(error.value)) < 300
    earlier = identity["settings"] | {"radius": None}
    write_json(path, {"identity": {**identity, "settings": earlier}})
    with pytest.raises(UserError, match=r"radius: the run has None, asked for no such setting;"):
        require_same_identity(path, identity)
    for damaged in ([], {"identity": "a mug"}):
        write_json(path, damaged)
        with pytest.raises(UserError, match="identity: expected an object"):
            require_same_identity(path, identity)
    write_json(path, {"identity": {}})
    with pytest.raises(UserError, match="another prompt"):
        require_same_identity(path, identity)
