import json

import pytest
import torch
from safetensors.torch import load_file, save_file

from gscomplete.errors import UserError
from gscomplete.priors.embedded.weights import (
    CONFIG_FILE,
    WEIGHTS_FILE,
    load_weights,
    pack_tensors,
    save_weights,
    unpack_tensors,
    words_digest,
)
from tests.builders.tiny_denoiser import tiny_config, tiny_model


@pytest.fixture
def folder(tmp_path):
    save_weights(tmp_path / "weights", tiny_model().state_dict(), tiny_config())
    return tmp_path / "weights"


def test_int8_is_within_half_a_step_of_every_row():
    value = torch.randn(5, 3, 2, 2) * torch.logspace(-6, 3, 5)[:, None, None, None]
    value[2] = 0
    state = {"kernel": value, "bias": torch.randn(5)}
    back = unpack_tensors(pack_tensors(state, "int8"))
    assert set(back) == set(state)
    # half a step, and the scale's own rounding to float16 (subnormal for the smallest rows)
    step = (value.flatten(1).abs().amax(1) / 127).clamp(min=2.0**-24)
    tolerance = step * 0.56 + 127 * 2.0**-25
    assert ((back["kernel"] - value).flatten(1).abs().amax(1) <= tolerance).all()
    torch.testing.assert_close(back["bias"], state["bias"], rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize(("storage", "tolerance"), [("float32", 0.0), ("float16", 1e-3)])
def test_wider_storage_is_closer(storage, tolerance):
    state = {"kernel": torch.randn(4, 6)}
    back = unpack_tensors(pack_tensors(state, storage))
    torch.testing.assert_close(back["kernel"], state["kernel"], rtol=tolerance, atol=0.0)


def test_saving_what_was_loaded_keeps_it(folder, tmp_path):
    model, _, config = load_weights(folder)
    save_weights(tmp_path / "again", model.state_dict(), config)
    again, _, _ = load_weights(tmp_path / "again")
    for name, value in model.state_dict().items():
        torch.testing.assert_close(again.state_dict()[name], value, rtol=1e-3, atol=1e-7)
    assert (folder / CONFIG_FILE).read_bytes() == (tmp_path / "again" / CONFIG_FILE).read_bytes()


@pytest.mark.parametrize("name", [WEIGHTS_FILE, CONFIG_FILE])
def test_missing_files_are_named(folder, name):
    (folder / name).unlink()
    with pytest.raises(UserError, match=name):
        load_weights(folder)


def test_damaged_weights_are_refused(folder):
    path = folder / WEIGHTS_FILE
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(UserError, match="safetensors"):
        load_weights(folder)


def test_other_version_is_refused(folder):
    path = folder / CONFIG_FILE
    path.write_text(json.dumps(json.loads(path.read_text()) | {"format_version": 99}))
    with pytest.raises(UserError, match="format_version: expected 3, found 99"):
        load_weights(folder)


def test_files_of_two_exports_are_not_mixed(folder):
    path = folder / CONFIG_FILE
    data = json.loads(path.read_text())
    data["words"] = ["chair", "blue", "mug", "red"]
    path.write_text(json.dumps(data))
    with pytest.raises(UserError, match="not of one export"):
        load_weights(folder)


def test_missing_tensor_is_refused(folder):
    path = folder / WEIGHTS_FILE
    _, _, config = load_weights(folder)
    tensors = load_file(path)
    tensors.pop("head.bias")
    save_file(tensors, path, metadata={"words_digest": words_digest(config.words)})
    with pytest.raises(UserError, match=r"head\.bias"):
        load_weights(folder)
