"""The recipes of docs/extending.md, followed."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

import gscomplete
from gscomplete.completion.presets import DISTILL
from gscomplete.errors import UserError
from gscomplete.priors import load_prior
from gscomplete.render import Render, render
from gscomplete.splats import read_splats, write_splats
from gscomplete.splats.formats.any_file import read_any_splats, write_any_splats
from gscomplete.views import ViewDistribution
from splatcomplete_data.cli.common import ObjectDraft, ObjectOptions, store_object
from splatcomplete_data.objects import StepRecord, read_record
from splatcomplete_data.points import points_to_splats
from tests.builders.objects import ball
from tests.builders.toy_prior import BallPrior

TRUTH = ball(1500)
PARTIAL = TRUTH.select(TRUTH.means[:, 0] > 0)


def test_a_prior_of_ones_own_completes_an_object():
    """The missing half of the ball is filled, with the prior named as the command line names it."""
    settings = dataclasses.replace(DISTILL, steps=40, new_splats=400, warmup_steps=4)
    found = gscomplete.complete(
        PARTIAL,
        "anything",
        prior="tests.builders.toy_prior:make",
        settings=settings,
        view_deg=(0.0, 10.0),
        center_file=(0.0, 0.0, 0.0),
        size_file=0.8,
    )
    behind = found.new_in_file.means[:, 0] < -0.1
    assert int(behind.sum()) > 20
    assert "the toy prior reads no text" in found.notes


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("tests.builders.toy_prior:none", "found no such"),
        ("tests.no_such_module:make", "found no such"),
        ("builtins:str", "without name, views"),
    ],
)
def test_what_is_no_prior_is_refused(name, why):
    with pytest.raises(UserError, match=why):
        load_prior(name)


@pytest.mark.parametrize(
    ("prior", "why"),
    [(BallPrior, "found the class BallPrior itself"), (object(), "without name, views")],
)
def test_what_is_no_prior_is_refused_as_an_object_too(prior, why):
    with pytest.raises(UserError, match=f"prior: expected a prior, .*{why}"):
        gscomplete.complete(PARTIAL, "anything", prior=prior)


class Odd(BallPrior):
    """Returns its pictures and losses changed by a function."""

    def __init__(self, change):
        self.change = change

    def distill(self, *given, **named):
        return self.change(super().distill(*given, **named))

    def reconstruct(self, *given, **named):
        color, alpha = super().reconstruct(*given, **named)
        return self.change(color), alpha


@pytest.mark.parametrize(
    ("mode", "change", "message"),
    [
        ("distill", torch.Tensor.detach, "distill: expected a loss with gradients to the renders"),
        ("distill", float, "distill: expected a tensor, found float"),
        ("distill", lambda x: x.repeat(3), r"distill: expected one number, found shape \(3,\)"),
        ("reconstruct", lambda x: x.permute(0, 3, 1, 2), r"reconstruct: expected colours \[4, h"),
    ],
)
@pytest.mark.filterwarnings("ignore:Converting a tensor")
def test_what_a_prior_must_not_return_is_told(mode, change, message):
    """The steps of the warm-up would pass without guidance, for the preservation loss has some."""
    settings = dataclasses.replace(DISTILL, mode=mode, steps=4, new_splats=40, warmup_steps=4)
    with pytest.raises(UserError, match=f"prior ball: {message}"):
        gscomplete.complete(PARTIAL, "anything", prior=Odd(change), settings=settings)


@dataclasses.dataclass(frozen=True)
class GridOptions(ObjectOptions):
    """A new source: a text file that says how many points a cube's side has."""

    file: Path = Path("grid.txt")


def make_grid(options: GridOptions) -> ObjectDraft:
    count = int(options.file.read_text())
    points = torch.cartesian_prod(*[torch.linspace(0.0, 1.0, count)] * 3).numpy()
    kept = points[:, 0] < 0.6
    step = StepRecord("half", len(points), int(kept.sum()), {"behind": int((~kept).sum())})
    splats = points_to_splats(points[kept], np.full((int(kept.sum()), 3), 0.5))
    return ObjectDraft("lidar", options.file, splats, None, "Z", (step,), ("a grid",))


def test_a_source_of_ones_own_writes_an_object_folder_that_completes(tmp_path):
    source = tmp_path / "grid.txt"
    source.write_text("6")
    options = GridOptions(file=source, prompt="a cube", out=tmp_path / "cube")
    store_object(options, make_grid(options))
    record = read_record(tmp_path / "cube")
    assert record.prompt == "a cube"
    assert record.steps[0].reasons == {"behind": 108}
    assert len(read_splats(tmp_path / "cube/partial.ply").splats) == 108


def test_a_format_goes_round_and_broken_files_are_refused(tmp_path):
    write_splats(tmp_path / "a.ply", PARTIAL)
    plain = read_splats(tmp_path / "a.ply").splats
    path = tmp_path / "a.splat"
    write_any_splats(path, plain)
    back = read_any_splats(path).splats
    # A .splat file keeps float32 positions, in another order.
    assert torch.equal(back.means.sort(dim=0).values, plain.means.sort(dim=0).values)
    path.write_bytes(path.read_bytes()[:-5])
    with pytest.raises(UserError, match=r"a\.splat"):
        read_any_splats(path)


def covered_share(drawn: Render) -> float | None:
    """A new metric: mean alpha of the pixels; None where there are none."""
    return float(drawn.alpha.mean()) if drawn.alpha.numel() else None


def test_a_metric_agrees_with_its_slow_twin():
    camera = ViewDistribution(0.0, 10.0).input_camera(24)
    found = covered_share(render(PARTIAL, camera))
    slow = render(PARTIAL.to("cpu", torch.float64), camera, backend="reference")
    assert found == pytest.approx(float(slow.alpha.sum()) / 24**2, abs=1e-5)
    assert covered_share(Render(*[torch.zeros(0)] * 3)) is None
