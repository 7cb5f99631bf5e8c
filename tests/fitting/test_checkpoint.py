"""A checkpoint is written whole or not at all, and one that does not fit is named."""

import stat
from pathlib import Path

import pytest
import torch

from gscomplete.errors import UserError
from gscomplete.fitting.checkpoint import FILE_NAME, check_fits, load_checkpoint, save_checkpoint
from tests.builders.full_disk import files_end_at

PATH = Path("latest.safetensors")


def fresh() -> dict[str, torch.Tensor]:
    return {
        "step": torch.tensor(0),
        "statistics.total": torch.zeros(3),
        "value.means": torch.zeros(3, 3),
        "value.sh": torch.zeros(3, 1, 3),
    }


def later(rows: int = 5) -> dict[str, torch.Tensor]:
    state = {
        "step": torch.tensor(7),
        "statistics.total": torch.zeros(rows),
        "value.means": torch.zeros(rows, 3),
        "value.sh": torch.zeros(rows, 1, 3),
    }
    for name in ("means", "sh"):
        state[f"adam.{name}.step"] = torch.tensor(7.0)
        for key in ("exp_avg", "exp_avg_sq"):
            state[f"adam.{name}.{key}"] = state[f"value.{name}"].clone()
    return state


def test_what_fits_passes():
    check_fits(PATH, fresh(), fresh(), 10)
    check_fits(PATH, later(), fresh(), 10)


def test_a_value_that_does_not_move_has_no_moments():
    colors_alone = {name: value for name, value in later().items() if "adam.means" not in name}
    check_fits(PATH, colors_alone, fresh(), 10)


def test_none_is_enough_where_there_were_none():
    nothing = {name: value[:0] if value.ndim else value for name, value in fresh().items()}
    check_fits(PATH, nothing, nothing, 10)
    with pytest.raises(UserError, match=r"value\.means: expected one row a splat, found none"):
        check_fits(PATH, nothing, fresh(), 10)


@pytest.mark.parametrize("step", [-5, 10**9, 11])
def test_a_step_that_the_job_has_not_is_named(step):
    state = later() | {"step": torch.tensor(step)}
    with pytest.raises(UserError, match=f"step: expected 0 to 10, found {step}"):
        check_fits(PATH, state, fresh(), 10)


@pytest.mark.parametrize("name", [name for name in later() if name != "step"])
@pytest.mark.parametrize("damage", ["dropped", "short", "empty", "type", "flat"])
def test_a_damaged_tensor_is_named(name, damage):
    state = later()
    value = state.pop(name)
    damaged = {
        "short": value[:-1] if value.ndim else value[None],
        "empty": value[:0] if value.ndim else torch.zeros(0),
        "type": value.to(torch.int32),
        "flat": value.reshape(-1)[: 1 if value.ndim == 1 else None][None],
    }
    if damage != "dropped":
        state[name] = damaged[damage]
    with pytest.raises(UserError, match=r"latest\.safetensors: .*: expected"):
        check_fits(PATH, state, fresh(), 10)


def test_a_full_disk_is_named_and_leaves_the_checkpoint_before(tmp_path):
    """Writing beyond a limit of the process fails as on a full disk."""
    save_checkpoint(tmp_path, {"step": torch.tensor(1)})
    told = r"latest\.safetensors: cannot write: the file would"
    with files_end_at(4096), pytest.raises(UserError, match=told):
        save_checkpoint(tmp_path, {"step": torch.tensor(2), "a": torch.zeros(10_000)})
    state = load_checkpoint(tmp_path)
    assert state is not None
    assert int(state["step"]) == 1
    assert [path.name for path in tmp_path.iterdir()] == [FILE_NAME]


def test_a_checkpoint_has_the_permissions_of_any_file(tmp_path):
    save_checkpoint(tmp_path, {"step": torch.tensor(1)})
    (tmp_path / "other").write_text("")
    modes = {stat.S_IMODE(path.stat().st_mode) for path in tmp_path.iterdir()}
    assert len(modes) == 1
