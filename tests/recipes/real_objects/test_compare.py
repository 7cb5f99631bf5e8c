"""The bound that knows the shape: exact silhouettes, P's records left out, P's nearest colours."""

import dataclasses

import torch

from gscomplete.completion.settings import CompletionSettings
from gscomplete.evaluate.metrics import against_truth
from gscomplete.priors import Prior, load_prior
from gscomplete.splats import Splats, colors_to_sh, concatenate
from gscomplete.views import ViewDistribution
from recipes.real_objects import compare
from recipes.real_objects.compare import FramedObject, outcome_of, true_shape
from recipes.real_objects.load import RealObject


def two_colored_plate() -> tuple[Splats, Splats]:
    """Return a plate that is red left of x = 0.2 and green right of it, and its left half."""
    along = torch.linspace(-0.45, 0.45, 60)
    y, z = torch.meshgrid(along, along, indexing="ij")
    means = torch.stack([y.flatten(), torch.zeros(3600), z.flatten()], dim=1)
    colors = torch.where(
        means[:, :1] < 0.2, torch.tensor([0.9, 0.1, 0.1]), torch.tensor([0.1, 0.9, 0.1])
    )
    quaternions = torch.zeros(3600, 4)
    quaternions[:, 0] = 1.0
    scales = torch.full((3600, 3), 0.012)
    complete = Splats(means, quaternions, scales, torch.full((3600,), 0.95), colors_to_sh(colors))
    return complete, complete.select(means[:, 0] < 0.0)


def framed(complete: Splats | None, part: Splats) -> FramedObject:
    item = RealObject("plate", "a plate", "Z", part, complete, "half of it")
    return FramedObject(item, part, complete, ViewDistribution(-90.0, 0.0))


def test_the_bound_has_the_true_shape_and_only_colors_that_are_seen() -> None:
    complete, part = two_colored_plate()
    one = framed(complete, part)
    new = true_shape(one)
    assert new is not None
    assert len(new) == len(complete) - len(part)
    torch.testing.assert_close(new.base_colors, part.base_colors[:1].expand(len(new), -1))
    found = against_truth(concatenate([part, new]), part, complete, one.views.ring(4, 64))
    assert found.silhouette_iou > 0.999
    psnr = found.hidden_color_psnr_db
    # Of the hidden half five ninths are green and shown red: 0.8 off in two of three channels.
    assert psnr is not None
    assert 5.0 < psnr < 7.5
    right = dataclasses.replace(new, sh=complete.select(complete.means[:, 0] >= 0.0).sh)
    better = against_truth(concatenate([part, right]), part, complete, one.views.ring(4, 64))
    assert better.hidden_color_psnr_db is not None
    assert better.hidden_color_psnr_db > 40.0


def test_without_a_truth_there_is_no_bound() -> None:
    _, part = two_colored_plate()
    assert true_shape(framed(None, part)) is None


def test_a_capture_is_completed_as_one(monkeypatch) -> None:
    told: list[bool] = []

    def completed(framed: FramedObject, prior: Prior, settings: CompletionSettings) -> None:
        told.append(settings.captured)

    monkeypatch.setattr(compare, "completed_as_run", completed)
    one = framed(*two_colored_plate())
    captured = dataclasses.replace(one, item=dataclasses.replace(one.item, captured=True))
    for part in (one, captured):
        outcome_of(part, "fast", load_prior("embedded"), 0)
    assert told == [False, True]
