"""A few of the fuzzer's mutations; ``python -m recipes.stress_readers`` runs thousands."""

import json
import logging
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch

from recipes.stress_readers.finite import require_finite
from recipes.stress_readers.mutations import damage_bytes, mutate
from recipes.stress_readers.packings import damage_inside
from recipes.stress_readers.seeds import seed_files
from recipes.stress_readers.trees import damage_tree
from recipes.stress_readers.worker import mutated, try_reader


def test_mutated_files_are_read_or_refused(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for module in ("laspy", "gsply", "yaml", "diffusers"):
        pytest.importorskip(module)
    caplog.set_level(logging.CRITICAL)
    seeds = seed_files(tmp_path / "seeds")
    answers = {}
    for path, reader in seeds:
        assert try_reader(reader, tmp_path / "seeds" / path, 300) == "read", path
    for number, path, reader in mutated(tmp_path, seeds, 1, range(4 * len(seeds))):
        answers[f"{number} {path}"] = try_reader(reader, tmp_path / "mutated" / path, 20)
    odd = {name: answer for name, answer in answers.items() if answer not in ("read", "refused")}
    assert odd == {}
    assert sum(answer == "refused" for answer in answers.values()) > len(seeds)


def test_a_mutation_is_a_function_of_seed_and_number() -> None:
    data = json.dumps({"a": [1, 2], "b": {"c": "x"}}).encode()
    for name in ("a.json", "a.bin"):
        assert mutate(name, data, 0, 3) == mutate(name, data, 0, 3)
        assert len({mutate(name, data, 0, number) for number in range(50)}) > 30


@pytest.mark.parametrize("name", ["a.npz", "a.png", "a.safetensors", "a.spz", "a.glb", "a.jsonl"])
def test_packing_stays_valid(tmp_path: Path, name: str) -> None:
    """So that damage reaches what is packed, not only checksums."""
    import trimesh
    from PIL import Image
    from safetensors.numpy import save_file

    path = tmp_path / name
    rng = np.random.default_rng(0)
    if name == "a.npz":
        np.savez(path, a=np.arange(9), b=np.ones(3))
    elif name == "a.png":
        Image.fromarray(rng.integers(0, 255, (8, 8), np.uint8)).save(path)
    elif name == "a.safetensors":
        save_file({"a": np.ones((2, 3), np.float32)}, path)
    elif name == "a.spz":
        import gzip

        path.write_bytes(gzip.compress(b"NGSP" + bytes(40)))
    elif name == "a.glb":
        trimesh.creation.box().export(path)
    else:
        path.write_text('{"a": 1}\n{"a": 2}\n')
    data = path.read_bytes()
    for _ in range(40):
        damaged = damage_inside(name, data, rng, damage_bytes)
        assert damaged is not None
        if name == "a.npz":
            path.write_bytes(damaged)
            with zipfile.ZipFile(path) as archive:
                assert archive.testzip() is None
        elif name == "a.safetensors":
            json.loads(damaged[8 : 8 + int.from_bytes(damaged[:8], "little")])
        elif name == "a.glb":
            assert int.from_bytes(damaged[8:12], "little") == len(damaged)
        elif name == "a.jsonl":
            assert [json.loads(line) is not Ellipsis for line in damaged.splitlines()] == [True] * 2


def test_trees_are_damaged_and_what_they_came_from_is_not() -> None:
    value = {"a": [1, 2, {"b": "x"}], "c": None}
    before = json.dumps(value)
    rng = np.random.default_rng(0)
    found = {json.dumps(damage_tree(value, rng)) for _ in range(60)}
    assert len(found) > 40
    assert json.dumps(value) == before


@pytest.mark.parametrize(
    "value", [float("nan"), [1.0, float("inf")], {"a": np.array([np.nan])}, torch.tensor([-np.inf])]
)
def test_what_is_not_finite_is_found(value: object) -> None:
    require_finite({"a": [1, "x", None, np.arange(3), torch.ones(2)]})
    with pytest.raises(ValueError, match="finite"):
        require_finite(value)
