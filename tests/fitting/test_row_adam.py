"""Adam whose rows come and go: the numbers of PyTorch's own, without loading its compiler."""

import subprocess
import sys

import pytest
import torch

from gscomplete.fitting.row_adam import MOMENTS, RowAdam

RATES = {"means": 3e-3, "opacity_logits": 0.3}


def values(rows: int = 7) -> dict[str, torch.Tensor]:
    draw = torch.Generator().manual_seed(rows)
    shapes = {"means": (rows, 3), "opacity_logits": (rows,)}
    return {
        name: torch.randn(shape, generator=draw).requires_grad_() for name, shape in shapes.items()
    }


def give_gradients(of: dict[str, torch.Tensor], seed: int) -> None:
    draw = torch.Generator().manual_seed(seed)
    for name, value in of.items():
        # At step 2 one value has no gradient, as where a loss does not depend on it.
        if (name, seed) != ("means", 2):
            value.grad = torch.randn(value.shape, generator=draw) * 10.0**-seed


@pytest.mark.parametrize("fused", [False, True])
def test_the_bits_are_those_of_pytorchs_adam(fused):
    ours, theirs = values(), values()
    adam = RowAdam(ours, RATES, fused=fused)
    groups = [{"params": [theirs[name]], "lr": RATES[name]} for name in theirs]
    torchs = torch.optim.Adam(
        groups, eps=1e-15, fused=fused or None, foreach=None if fused else False
    )
    for step in range(5):
        adam.rates["means"] = torchs.param_groups[0]["lr"] = 3e-3 * 0.8**step
        give_gradients(ours, step)
        give_gradients(theirs, step)
        adam.step()
        torchs.step()
        torchs.zero_grad(set_to_none=True)
        assert all(value.grad is None for value in ours.values())
        for name, value in theirs.items():
            assert torch.equal(ours[name], value)
            for key in ("step", *MOMENTS):
                assert torch.equal(adam.moments[name][key], torchs.state[value][key])


def test_moments_follow_their_rows():
    """A kept row goes on as if nothing had changed; an added one starts at rest."""
    first, keep = values(4), torch.tensor([True, False, True, True])
    adam = RowAdam(first, RATES)
    give_gradients(first, 0)
    adam.step()
    edited = {
        name: torch.cat([value.detach()[keep], value.detach()[:1]]).requires_grad_()
        for name, value in first.items()
    }
    after = adam.with_rows(edited, keep, 1)
    for name, moments in after.moments.items():
        for key in MOMENTS:
            assert torch.equal(moments[key][:3], adam.moments[name][key][keep])
            assert not moments[key][3:].any()
    again = RowAdam(edited, RATES)
    again.restore(after.flat_state())
    assert torch.equal(again.moments["means"]["exp_avg"], after.moments["means"]["exp_avg"])
    after.forget("means")
    assert not after.moments["means"]["exp_avg"].any()
    assert after.moments["opacity_logits"]["exp_avg"].any()


def test_the_compiler_of_pytorch_stays_unloaded():
    """It would take longer to load than a default completion takes to compute."""
    code = (
        "import sys, torch\n"
        "from gscomplete.fitting.row_adam import RowAdam\n"
        "value = torch.zeros(3, requires_grad=True)\n"
        "adam = RowAdam({'a': value}, {'a': 1.0})\n"
        "value.sum().backward()\n"
        "adam.step()\n"
        "assert float(value.max()) < -0.9\n"
        "assert 'torch._dynamo' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)
