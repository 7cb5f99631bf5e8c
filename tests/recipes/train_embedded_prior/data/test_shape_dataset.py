import dataclasses
import math

import numpy as np
import pytest
import torch

from gscomplete.priors.embedded.text import Tokenizer
from gscomplete.shape.voxels import splat_arrays
from gscomplete.splats.transform import transform_splats
from recipes.train_embedded_prior.config import ShapeDataConfig
from recipes.train_embedded_prior.data import shape_dataset
from recipes.train_embedded_prior.data.findings import Findings
from recipes.train_embedded_prior.data.shape_dataset import ShapeSetMaker, varied
from tests.builders.training import WORDS, stub_source


@pytest.fixture(scope="module")
def maker():
    return ShapeSetMaker(stub_source, ShapeDataConfig(slight_share=0.0), Tokenizer(WORDS, 16), 0)


def test_the_first_variant_is_the_set_itself_and_others_are_not(maker):
    first, second, third = maker.variants(3, 3)
    assert first.tobytes() == maker(3).tobytes()
    assert len({s["solid"].tobytes() for s in (first, second, third)}) == 3
    again = maker.variants(3, 2)[1]
    assert again.tobytes() == second.tobytes()


def test_what_was_found_out_before_is_not_found_out_again(maker, monkeypatch):
    """Stored planes are in float32, so cells may be filled a little differently."""
    plain = maker(3)
    findings = maker.findings(3)
    stored = Findings.of(findings.stored(3))
    other = dataclasses.replace(stored, splats=stored.splats + 1)

    def refuse(*_, **__):
        raise AssertionError("found out again")

    monkeypatch.setattr(shape_dataset, "guess_framing", refuse)
    monkeypatch.setattr(shape_dataset, "candidate_planes", refuse)
    found = maker.variants(3, 1, stored)[0]
    assert found["solid"].tobytes() == plain["solid"].tobytes()
    assert found["evidence"].tobytes() == plain["evidence"].tobytes()
    assert found["scores"] == pytest.approx(plain["scores"], abs=1e-6)
    with pytest.raises(AssertionError, match="found out again"):
        maker.variants(3, 1, other)


@pytest.mark.parametrize("seed", range(4))
def test_planes_go_where_their_object_goes(maker, seed, monkeypatch):
    monkeypatch.setattr(shape_dataset, "_CUT_AGAIN_SHARE", 0.0)
    posed = maker.posed(3, np.random.default_rng(0))
    planes = posed.planes()
    moved, moved_planes = varied(posed, planes, np.random.default_rng(seed))
    before, after = posed.partial.means.numpy(), moved.partial.means.numpy()
    # A similarity that carries the part to its new place carries its mirror images there, too.
    for plane, carried in zip(planes, moved_planes, strict=True):
        mirrored = dataclasses.replace(posed.partial, means=torch.from_numpy(plane.apply(before)))
        ours = transform_splats(mirrored, fitted_similarity(before, after)).means.numpy()
        np.testing.assert_allclose(carried.apply(after), ours, atol=2e-5)


def fitted_similarity(before, after):
    """Return the similarity about z between two sets of points."""
    from gscomplete.splats.transform import Similarity

    a, b = before - before.mean(0), after - after.mean(0)
    scale = float(np.linalg.norm(b) / np.linalg.norm(a))
    flat = a[:, 0] + 1j * a[:, 1]
    angle = float(np.angle(np.vdot(flat, b[:, 0] + 1j * b[:, 1])))
    cos, sin = math.cos(angle), math.sin(angle)
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1.0]])
    shift = after.mean(0) - scale * (turn @ before.mean(0))
    return Similarity(scale, torch.from_numpy(turn), torch.from_numpy(shift).double())


def test_parts_cut_again_are_parts(maker, monkeypatch):
    monkeypatch.setattr(shape_dataset, "_CUT_AGAIN_SHARE", 1.0)
    posed = maker.posed(3, np.random.default_rng(0))
    counts = [len(varied(posed, (), np.random.default_rng(seed))[0].partial) for seed in range(12)]
    full = len(posed.partial)
    assert all(full / 2 <= count <= full for count in counts)
    assert len(set(counts)) > 6
    moved, _ = varied(posed, (), np.random.default_rng(0))
    assert len(moved.complete) == len(posed.complete)
    assert np.isfinite(splat_arrays(moved.partial)[0]).all()
