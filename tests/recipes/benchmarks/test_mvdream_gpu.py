"""The GPU benchmark runs from end to end, at reduced width and without a GPU."""

import pytest
import torch

pytest.importorskip("diffusers", reason="the extra gscomplete[mvdream] is not installed")
pytest.importorskip("transformers", reason="the extra gscomplete[mvdream] is not installed")

from recipes.benchmarks.mvdream_gpu import Options, measure


def test_runs_at_reduced_width_on_the_cpu():
    torch.manual_seed(0)
    options = Options(
        device="cpu", partial_splats=60, new_splats=60, steps=1, compile="off", reduced=True
    )
    found = {}
    for numbers in measure(options):
        found |= numbers
    parts = found["ours_parts_ms"]
    named = ("unet", "vae forward", "render forward", "backward (all)", "rest")
    assert sum(parts[name] for name in named) == pytest.approx(parts["step"])
    assert all(parts[name] > 0 for name in named)
    assert found["ours_ms"] > 0
    assert found["plain_ms"] > 0
    assert found["network_tflop_per_step"] > 1e-5
    assert 0 < found["share_of_peak"] < 2
