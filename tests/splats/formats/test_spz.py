"""SPZ files keep the geometry of splats of any size, or are refused."""

import dataclasses
import math
from pathlib import Path

import pytest
import torch

from gscomplete.errors import UserError
from gscomplete.splats import Splats
from gscomplete.splats.formats.spz import COARSEST_STEP, FINE_STEP, read_spz, write_spz
from tests.builders.objects import random_splats, round_splats

gsply = pytest.importorskip("gsply")


def unit_cube(side: float = 1.0, at: float = 0.0) -> Splats:
    """Splats in a cube, of a hundredth of its side, with splats on two of its corners."""
    means = torch.rand(200, 3, generator=torch.Generator().manual_seed(0))
    means[0], means[1] = 0.0, 1.0
    return round_splats(side * means.double() + at, scale=0.01 * side)


@pytest.mark.parametrize(
    ("side", "at"), [(5000.0, -2500.0), (1.0, 500.0), (1.0, 0.0), (0.01, 0.0), (1e6, 2e6)]
)
@pytest.mark.parametrize("version", [3, 4])
def test_positions_of_objects_of_any_size_stay(
    tmp_path: Path, side: float, at: float, version: int
) -> None:
    splats = unit_cube(side, at)
    (quantised, *_) = write_spz(tmp_path / "a.spz", splats, version)  # type: ignore[arg-type]
    step = float(quantised.split("steps of ")[1].rstrip(")"))
    assert step < COARSEST_STEP * side
    back = read_spz(tmp_path / "a.spz").means
    # a half, and 1 % for the step's own rounding in the note
    torch.testing.assert_close(back, splats.means, atol=0.51 * step, rtol=0)
    # a step is fine enough, or twice as far would not fit, or the format has no finer one
    is_fine = step < FINE_STEP * side * 1.01
    assert is_fine or 2**22 * step < 1.01 * float(splats.means.abs().max()) or step < 2**-23.9
    assert step > 0.4 * FINE_STEP * side or step == 2**-1  # a bit at least is fractional


def test_other_readers_get_the_bits_from_the_header(tmp_path: Path) -> None:
    splats = unit_cube(5000.0)
    write_spz(tmp_path / "a.spz", splats)
    means = torch.from_numpy(gsply.read_spz(tmp_path / "a.spz").means)
    torch.testing.assert_close(
        means, splats.means * torch.tensor([1.0, -1.0, -1.0]), atol=2**-6, rtol=0
    )


@pytest.mark.parametrize(
    "splats",
    [
        pytest.param(unit_cube(1.0, 20_000.0), id="far from the origin"),
        pytest.param(unit_cube(1e-5), id="too small"),
        pytest.param(unit_cube(2e7), id="too large"),
        pytest.param(
            round_splats(torch.cat([unit_cube().means, torch.full((2, 3), 1e5)])), id="a floater"
        ),
    ],
)
def test_steps_too_coarse_for_the_object_are_refused(tmp_path: Path, splats: Splats) -> None:
    with pytest.raises(UserError, match=r"a\.spz: SPZ: expected .* found steps of .* \.ply"):
        write_spz(tmp_path / "a.spz", splats)
    assert list(tmp_path.iterdir()) == []


def test_scales_beyond_the_bytes_are_counted(tmp_path: Path) -> None:
    splats = random_splats(30)
    scales = splats.scales.clone()
    scales[:3, 1], scales[5, 0], scales[6] = 1e-7, math.exp(20), 370.0
    odd = dataclasses.replace(splats, scales=scales)
    lost = write_spz(tmp_path / "a.spz", odd)
    assert "scales below 4.54e-05 of 3 splats (written as 4.54e-05)" in lost
    assert "scales above 379 of 1 splats (written as 379)" in lost
    assert len(write_spz(tmp_path / "a.spz", splats)) == 1
