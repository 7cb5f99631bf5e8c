"""Adam whose rows come and go: the numbers of PyTorch's own, without loading its compiler."""

import subprocess
import sys

import pytest
import torch

from gscomplete.fitting.row_adam import MOMENTS, RowAdam, _update
from tests.builders.commands import PATIENCE_S

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


@pytest.mark.parametrize("device", ["cpu", "any"])
def test_columns_move_at_their_own_rates(device, monkeypatch):
    """As two parameters of PyTorch's Adam do; the last bits differ, in which terms are grouped."""
    draw = torch.Generator().manual_seed(0)
    sh = torch.randn(5000, 4, 3, generator=draw)
    ours = {"sh": sh.clone().requires_grad_()}
    theirs = [sh[:, :1].clone().requires_grad_(), sh[:, 1:].clone().requires_grad_()]
    rates = torch.full((4, 3), 1e-3)
    rates[0] = 0.1
    adam = RowAdam(ours, {"sh": rates.flatten()}, fused=True)
    if device == "any":
        monkeypatch.setattr("gscomplete.fitting.row_adam._update_columns", _update)
    groups = [{"params": [theirs[0]], "lr": 0.1}, {"params": [theirs[1]], "lr": 1e-3}]
    torchs = torch.optim.Adam(groups, eps=1e-15)
    for step in range(5):
        gradient = torch.randn(sh.shape, generator=draw) * 10.0**-step
        gradient[step::7] = 0.0
        ours["sh"].grad = gradient.clone()
        theirs[0].grad, theirs[1].grad = gradient[:, :1].clone(), gradient[:, 1:].clone()
        adam.step()
        torchs.step()
    # Each step's difference of a few float32 roundings, of values around 1.
    torch.testing.assert_close(ours["sh"].detach(), torch.cat(theirs, 1), rtol=0, atol=2e-6)
    moved = (ours["sh"].detach() - sh).abs().amax(dim=(0, 2))
    assert moved[0] > 50 * moved[1:].max()


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
    subprocess.run([sys.executable, "-c", code], check=True, timeout=PATIENCE_S)
