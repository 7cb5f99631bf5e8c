"""SSIM: its formula on pictures where it is known, and a slow second computation."""

import numpy as np
import pytest
import torch

from gscomplete.evaluate.ssim import ssim_map


def pictures() -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(2)
    a = torch.rand(1, 24, 20, 3, generator=generator).double()
    return a, (0.7 * a + 0.3 * torch.rand(1, 24, 20, 3, generator=generator)).double()


def test_the_same_is_one_and_plain_pictures_have_a_known_answer():
    a, _ = pictures()
    assert float((ssim_map(a, a) - 1).abs().max()) < 1e-9
    dark, bright = (torch.full((1, 16, 16, 3), x) for x in (0.25, 0.75))
    expected = (2 * 0.25 * 0.75 + 1e-4) / (0.25**2 + 0.75**2 + 1e-4)  # no variance: luminance alone
    assert float(ssim_map(dark, bright)[0, 8, 8]) == pytest.approx(expected, rel=1e-6)


def test_a_second_computation_agrees():
    """Window by window, as Wang et al. (2004) define it."""
    a, b = pictures()
    found = ssim_map(a, b)[0]
    offset = np.arange(11) - 5
    line = np.exp(-0.5 * (offset / 1.5) ** 2)
    weight = np.outer(line, line) / line.sum() ** 2
    for row, column in ((5, 5), (12, 9), (18, 14)):
        values = []
        for channel in range(3):
            x, y = (
                p[0, row - 5 : row + 6, column - 5 : column + 6, channel].numpy() for p in (a, b)
            )
            mx, my = (weight * x).sum(), (weight * y).sum()
            vx, vy = (weight * (x - mx) ** 2).sum(), (weight * (y - my) ** 2).sum()
            both = (weight * (x - mx) * (y - my)).sum()
            values.append(
                (2 * mx * my + 1e-4) * (2 * both + 9e-4)
                / ((mx**2 + my**2 + 1e-4) * (vx + vy + 9e-4))
            )  # fmt: skip
        assert float(found[row, column]) == pytest.approx(float(np.mean(values)), rel=1e-9)
