"""HaarPSI equals another implementation's values, and its mask does what it says."""

import pytest
import torch

from gscomplete.evaluate.haarpsi import haarpsi


def pictures() -> tuple[torch.Tensor, torch.Tensor]:
    y, x = torch.meshgrid(torch.arange(48.0), torch.arange(64.0), indexing="ij")
    waves = [0.5 + 0.4 * torch.sin(x / 3 + y / 7), 0.5 + 0.3 * torch.cos(x * y / 200), x / 64]
    a = torch.stack(waves, -1)[None]
    b = (0.8 * a + 0.1 + 0.1 * torch.sin(x / 1.7)[None, ..., None]).clamp(0, 1)
    return a.double(), b.double()


def test_values_are_those_of_piq():
    """piq 0.8.0, ``haarpsi`` in float64, of the same pictures."""
    a, b = pictures()
    assert float(haarpsi(a, b)) == pytest.approx(0.6366653613484975, rel=1e-6)
    assert float(haarpsi(a, a.flip(2))) == pytest.approx(0.30512794836499835, rel=1e-6)


def test_the_same_is_one_and_order_does_not_matter():
    a, b = pictures()
    assert float(haarpsi(a, a)) == pytest.approx(1.0, abs=1e-6)
    assert float(haarpsi(a, b)) == float(haarpsi(b, a))
    both = haarpsi(torch.cat([a, b]), torch.cat([b, b]))
    assert both.tolist() == pytest.approx([float(haarpsi(a, b)), 1.0], abs=1e-6)


def test_what_the_mask_leaves_out_does_not_count():
    a, b = pictures()
    far = torch.zeros(1, 48, 64).double()
    far[:, :, 48:] = 1.0  # a coefficient reaches 8 pixels of the halved picture
    changed = torch.where(torch.arange(64)[None, None, :, None] < 20, b, a)
    assert float(haarpsi(a, changed, far)) == pytest.approx(1.0, abs=1e-6)
    assert float(haarpsi(a, changed, 1 - far)) < 0.9
    assert float(haarpsi(a, b, torch.ones(1, 48, 64))) == pytest.approx(float(haarpsi(a, b)))
    assert float(haarpsi(a, b, torch.zeros(1, 48, 64))) == 1.0
