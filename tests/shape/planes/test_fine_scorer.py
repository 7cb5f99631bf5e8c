import math

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from gscomplete.errors import UserError
from gscomplete.shape.partial_voxels import voxelize_partial
from gscomplete.shape.planes.features import FEATURES
from gscomplete.shape.planes.fine_scorer import (
    FINE_SCORER_FILE,
    SIZE,
    STEP,
    FineSymmetryScorer,
    FoldedVolumes,
    colored_cells,
    folded_volumes,
    packaged_fine_scorer,
)
from gscomplete.shape.voxels import COARSE_CELLS, cell_centers
from gscomplete.views import ViewDistribution
from tests.builders.objects import ball

ANGLE, OFFSET = 0.7, 0.05


def one_plane() -> tuple[np.ndarray, np.ndarray]:
    return np.array([ANGLE], np.float32), np.array([OFFSET], np.float32)


def some_cells(count: int = 40) -> np.ndarray:
    rng = np.random.default_rng(3)
    return np.concatenate(
        [rng.uniform(-0.5, 0.5, (count, 3)), rng.uniform(size=(count, 4))], axis=1
    ).astype(np.float32)


def folded_by_hand(cells: np.ndarray) -> np.ndarray:
    """Spread cells in float64, one at a time, by their distance to every cell."""
    nu, nv, nz = SIZE
    normal = np.array([math.cos(ANGLE), math.sin(ANGLE), 0.0])
    along = np.array([-math.sin(ANGLE), math.cos(ANGLE), 0.0])
    out = np.zeros((2, 4, *SIZE))
    for row in cells.astype(np.float64):
        away = row[:3] @ normal - OFFSET
        u = abs(away) / STEP - 0.5
        v, z = row[:3] @ along / STEP + (nv - 1) / 2, row[2] / STEP + (nz - 1) / 2
        layers = np.clip(1 - np.abs(np.arange(-1, nu) - u), 0, None)
        layers[1] += layers[0]  # between the plane and the first layer
        share = np.einsum(
            "u,v,z->uvz",
            layers[1:],
            np.clip(1 - np.abs(np.arange(nv) - v), 0, None),
            np.clip(1 - np.abs(np.arange(nz) - z), 0, None),
        )
        side = 0 if away >= 0 else 1
        out[side] += share * row[6] * np.array([1.0, *row[3:6]])[:, None, None, None]
    return (out / np.maximum(out[:, :1], 1)).reshape(8, *SIZE)


def test_cells_are_folded_as_by_hand():
    cells = some_cells()
    evidence = np.zeros((3, *(COARSE_CELLS,) * 3), np.float32)
    found = folded_volumes(cells, evidence, *one_plane()).fine[0].numpy()
    # float32 places of cells, in cells: up to 30 times 6e-8, squared by three shares
    np.testing.assert_allclose(found, folded_by_hand(cells), atol=2e-5)
    assert found[:4].max() > 0.1
    assert found[4:].max() > 0.1


def test_evidence_is_looked_up_on_both_sides():
    """The evidence is the place itself: its value tells where it was looked up."""
    place = np.moveaxis(cell_centers(COARSE_CELLS), -1, 0).copy()
    coarse = folded_volumes(some_cells(), place, *one_plane()).coarse[0].numpy()
    normal = np.array([math.cos(ANGLE), math.sin(ANGLE), 0.0])
    nu, nv, nz = (n // 2 for n in SIZE)
    for side, sign in ((coarse[:3], 1), (coarse[3:], -1)):
        for u in (0, nu // 2):
            away = np.tensordot(normal, side[:, u], axes=1)[3:-3, 3:-3]
            assert away == pytest.approx(OFFSET + sign * (u + 0.5) * 2 * STEP, abs=1e-4)
    assert coarse[2, 0, 0] == pytest.approx((np.arange(nz) - (nz - 1) / 2) * 2 * STEP, abs=1e-4)
    assert coarse.shape == (6, nu, nv, nz)


def test_the_sides_of_a_plane_of_symmetry_are_alike():
    voxels = voxelize_partial(ball(), ViewDistribution(0.0, 10.0))
    fine = folded_volumes(colored_cells(voxels.volume), voxels.shares, np.zeros(1, np.float32),
                          np.zeros(1, np.float32)).fine[0]  # fmt: skip
    one, other = fine[0], fine[4]
    assert float((one - other).abs().mean()) < 0.1 * float(one.mean())


def test_judging_one_plane_or_many_is_the_same():
    scorer = packaged_fine_scorer()
    generator = torch.Generator().manual_seed(0)
    fine = torch.rand(3, 8, *SIZE, generator=generator)
    coarse = torch.rand(3, 6, *(n // 2 for n in SIZE), generator=generator)
    features, ranked = torch.rand(3, len(FEATURES), generator=generator), torch.zeros(3)
    together = torch.stack(scorer(FoldedVolumes(fine, coarse), features, ranked))
    for k in range(3):
        volumes = FoldedVolumes(fine[k : k + 1], coarse[k : k + 1])
        alone = torch.stack(scorer(volumes, features[k : k + 1], ranked[k : k + 1]))
        # float32 sums of 10^4 terms in another order
        torch.testing.assert_close(alone[:, 0], together[:, k], rtol=1e-3, atol=1e-3)


def test_files_are_checked(tmp_path):
    path = tmp_path / FINE_SCORER_FILE
    with pytest.raises(UserError, match=r"plane_judge\.safetensors"):
        FineSymmetryScorer.load(path)
    path.write_bytes(b"junk")
    with pytest.raises(UserError, match="expected a safetensors file"):
        FineSymmetryScorer.load(path)
    packaged_fine_scorer().save(path)
    assert FineSymmetryScorer.load(path).digest() == packaged_fine_scorer().digest()
    tensors = packaged_fine_scorer().state_dict()
    save_file({k: v.contiguous() for k, v in tensors.items() if k != "trust"}, path)
    with pytest.raises(UserError, match="expected tensors of the fine symmetry scorer"):
        FineSymmetryScorer.load(path)


def test_reading_draws_no_random_numbers(tmp_path):
    FineSymmetryScorer().save(tmp_path / "a.safetensors")
    before = torch.get_rng_state()
    FineSymmetryScorer.load(tmp_path / "a.safetensors")
    assert torch.equal(torch.get_rng_state(), before)
