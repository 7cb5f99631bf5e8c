"""Gaps are closed where they are, and nothing is added to what is complete, open, or half."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from scipy.spatial import cKDTree

from gscomplete.cli.complete import run
from gscomplete.cli.complete_options import CompleteOptions
from gscomplete.errors import UserError
from gscomplete.shape.fill.close import Filled, close_gaps
from gscomplete.splats import Splats, concatenate, read_splats, write_splats
from tests.builders.objects import ball, even_ball

CAP_TOP, CAP_SIDE = 0.96, 0.93
"""Cosines of the angles within which the holes lie: 16 and 22 degrees."""


def close(splats: Splats) -> Filled:
    return close_gaps(splats, torch.Generator().manual_seed(0))


def punched() -> tuple[Splats, Splats]:
    """A sphere with two round holes and a slit, and what lies in them."""
    whole = even_ball(12_000, 0.4)
    normals = whole.means / 0.4
    hole = (normals[:, 2] > CAP_TOP) | (normals[:, 0] > CAP_SIDE)
    slit = (normals[:, 1].abs() < 0.06) & (normals[:, 0] < -0.3)
    return whole.select(~(hole | slit)), whole.select(hole | slit)


@pytest.fixture(scope="module")
def filled() -> Filled:
    return close(punched()[0])


def test_holes_and_slits_are_closed_and_nothing_else(filled: Filled) -> None:
    part, missing = punched()
    to_rim, _ = cKDTree(part.means.numpy()).query(missing.means.numpy())
    to_new, _ = cKDTree(filled.splats.means.numpy()).query(missing.means.numpy())
    assert (to_rim > 0.02).mean() > 0.5
    # splats are 0.013 apart, and lids flatter than what they replace
    assert (to_new[to_rim > 0.02] < 0.035).all()
    to_hole, _ = cKDTree(missing.means.numpy()).query(filled.splats.means.numpy())
    assert (to_hole < 0.035).all()
    assert (filled.splats.means.norm(dim=1) - 0.4).abs().max() < 0.03  # flat, it would be 0.028
    assert "fill: " in filled.note


def test_colours_go_on_over_the_gap(filled: Filled) -> None:
    _, missing = punched()
    _, nearest = cKDTree(missing.means.numpy()).query(filled.splats.means.numpy())
    error = filled.splats.base_colors - missing.base_colors[torch.from_numpy(nearest)]
    # a mean of the rim: over the larger hole the true colour changes by 0.15 to each side
    assert error.abs().mean() < 0.07


def test_nothing_is_added_to_what_is_complete_or_half() -> None:
    whole = even_ball(6000, 0.4)
    for splats in (whole, whole.select(whole.means[:, 0] > 0.05)):
        assert len(close(splats).splats) == 0


def test_an_opening_that_shows_the_inside_stays() -> None:
    """A cup with an inner wall: its mouth shows fronts of surfaces."""
    outer = ball(8000)
    inner = ball(6000, 0.33)
    cup = concatenate([part.select(part.means[:, 2] < 0.1) for part in (outer, inner)])
    new = close(cup).splats
    assert not ((new.means[:, :2].norm(dim=1) < 0.25) & (new.means[:, 2] > 0.0)).any()


def test_the_command_fills_without_a_prompt(tmp_path, capsys) -> None:
    whole = even_ball(2500, 0.4)
    part = whole.select(whole.means[:, 2] < 0.36)
    write_splats(tmp_path / "part.ply", part)
    out, new = tmp_path / "run", tmp_path / "new.ply"
    options = CompleteOptions(
        partial=tmp_path / "part.ply", out=out, fill=True, new_only=new, device="cpu"
    )
    assert run(options) == 0
    told = capsys.readouterr().out
    assert "gaps closed" in told
    assert "prompt" not in told
    completed, alone = read_splats(out / "completed.ply"), read_splats(new)
    assert completed.n_rows == len(part) + alone.n_rows
    with pytest.raises(UserError, match=r"--fill: .* expected no --mirror"):
        run(dataclasses.replace(options, mirror="none", new_only=None, out=tmp_path / "other"))
