"""The pipeline in memory: the same completion as a run folder's, from splats or from a file."""

import dataclasses

import pytest
import torch

from gscomplete.api import complete
from gscomplete.completion import run_folder
from gscomplete.completion.pipeline import Request, finish, prepare
from gscomplete.completion.presets import DISTILL, GUESS, RECONSTRUCT
from gscomplete.completion.settings import HardPreservationSettings
from gscomplete.errors import UserError
from gscomplete.framing.decide import FramingRequest
from gscomplete.priors.base import FirstGuess
from gscomplete.splats import (
    Similarity,
    Splats,
    concatenate,
    read_splats,
    transform_splats,
    write_splats,
)
from gscomplete.splats.slits import slit_splats
from tests.builders.objects import ball, half, half_cylinder, leaning_board
from tests.builders.priors import GuessingPrior, OraclePrior
from tests.builders.simulated_gpu import simulated_gpu

TRUTH = ball(1500)
PARTIAL = TRUTH.select(TRUTH.means[:, 0] > 0)
QUICK = dataclasses.replace(DISTILL, steps=4, new_splats=200, warmup_steps=1)
NOTHING = FirstGuess(TRUTH.select(torch.arange(0)), ("not mirrored",))
KNOWN = {"view_deg": (0.0, 10.0), "center_file": (0.0, 0.0, 0.0), "size_file": 0.8}


def test_a_file_and_its_splats_are_completed_alike_and_a_run_folder_holds_the_same(tmp_path):
    path = tmp_path / "half.ply"
    write_splats(path, PARTIAL)
    prior = OraclePrior(TRUTH)
    reports = []
    of_file = complete(path, "a ball", prior=prior, settings=QUICK, on_step=reports.append, **KNOWN)
    of_splats = complete(read_splats(path).splats, "a ball", prior=prior, settings=QUICK, **KNOWN)
    of_read = complete(read_splats(path), "a ball", prior=prior, settings=QUICK, **KNOWN)
    for other in (of_splats, of_read):
        for (name, a), (_, b) in zip(of_file.new.fields(), other.new.fields(), strict=True):
            assert torch.equal(a, b), name
    assert [report.step for report in reports] == [0, 1, 2, 3]
    of_file.save(tmp_path / "saved.ply")
    framing = FramingRequest(**KNOWN)
    asked = Request("a ball", QUICK, framing)
    run = run_folder.prepare(run_folder.RunRequest(path, tmp_path / "run", asked), prior)
    run_folder.execute(run, lambda report: None)
    written = (tmp_path / "run" / run_folder.OUTPUT_FILE).read_bytes()
    assert written == (tmp_path / "saved.ply").read_bytes()
    assert len(of_splats.splats) == len(PARTIAL) + len(of_splats.new)


@pytest.mark.parametrize("kind", ["trainable", "float64"])
def test_splats_of_another_kind_are_completed_as_float32_and_kept(kind):
    given = PARTIAL.to(dtype=torch.float64)
    if kind == "trainable":
        given = dataclasses.replace(PARTIAL, means=PARTIAL.means.clone().requires_grad_())
    prior = OraclePrior(TRUTH)
    expected = complete(PARTIAL, "a ball", prior=prior, settings=QUICK, **KNOWN)
    found = complete(given, "a ball", prior=prior, settings=QUICK, **KNOWN)
    for (name, a), (_, b) in zip(found.new.fields(), expected.new.fields(), strict=True):
        assert torch.equal(a, b), name
        assert a.dtype == torch.float32
    assert found.given is given
    assert torch.equal(found.splats.means[: len(given)], given.means)


def test_splats_on_a_gpu_are_completed_on_the_cpu(monkeypatch):
    """As far as the first step, which reads numbers: those of the simulated GPU are none."""
    seen = []

    def working_set(splats, *_):
        seen.append(splats)
        raise Stop

    class Stop(Exception):
        pass

    monkeypatch.setattr("gscomplete.completion.pipeline.working_set", working_set)
    request = Request("a ball", QUICK, FramingRequest(**KNOWN))
    with simulated_gpu() as gpu:
        on_gpu = PARTIAL.to(gpu)
        with pytest.raises(Stop):
            prepare(on_gpu, request, OraclePrior(TRUTH))
    assert {value.device.type for _, value in on_gpu.fields()} == {"cuda"}
    assert {value.device.type for _, value in seen[0].fields()} == {"cpu"}


def test_what_is_added_lies_in_the_file_frame():
    """P moved, scaled and turned in its file: the same splats are added, moved with it."""
    moved = Similarity(3.0, torch.eye(3).double(), torch.tensor([5.0, -2.0, 1.0]).double())
    there = transform_splats(PARTIAL, moved)
    known = {"view_deg": (0.0, 10.0), "center_file": (5.0, -2.0, 1.0), "size_file": 2.4}
    prior = OraclePrior(TRUTH)
    here = complete(PARTIAL, "a ball", prior=prior, settings=QUICK, **KNOWN)
    found = complete(there, "a ball", prior=prior, settings=QUICK, **known)
    expected = transform_splats(here.new_in_file, moved)
    # Float32 positions five units away have a spacing of 5e-7; four steps of Adam amplify it.
    assert torch.allclose(found.new_in_file.means, expected.means, atol=2e-3)


def test_where_nothing_is_missing_nothing_is_added():
    prior = GuessingPrior(TRUTH, FirstGuess(TRUTH.select(torch.arange(0)), ("not mirrored",)))
    found = complete(PARTIAL, "a ball", prior=prior, settings=GUESS, **KNOWN)
    assert len(found.new) == 0
    assert found.hard_preservation is not None
    assert found.hard_preservation.met


@pytest.mark.parametrize("heeds_strays", [False, True])
def test_nothing_is_guessed_from_strays_but_the_output_keeps_them(
    heeds_strays, tmp_path, monkeypatch
):
    dense = half(ball(6000))
    generator = torch.Generator().manual_seed(2)
    strays = dense.select(torch.arange(20))
    away = torch.nn.functional.normalize(torch.randn(20, 3, generator=generator), dim=1)
    given = concatenate([dense, dataclasses.replace(strays, means=0.7 * away)])
    path = tmp_path / "p.ply"
    write_splats(path, given)
    seen = []

    def guess(self: GuessingPrior, partial: Splats, *args: object, **named: object) -> FirstGuess:
        seen.append(partial)
        return NOTHING

    monkeypatch.setattr(GuessingPrior, "first_guess", guess)
    settings = dataclasses.replace(GUESS, leave_out_strays=not heeds_strays)
    found = complete(
        path, "a ball", prior=GuessingPrior(TRUTH, NOTHING), settings=settings, **KNOWN
    )
    told = "nothing is guessed from 20 strays beside the surface"
    assert any(told in note for note in found.notes) != heeds_strays
    assert len(found.partial) == len(given)
    assert len(seen[0]) == len(given if heeds_strays else dense)
    found.save(tmp_path / "o.ply")
    rows = path.read_bytes().split(b"end_header\n", 1)[1]
    assert rows in (tmp_path / "o.ply").read_bytes()


SCAN = {"view_deg": (0.0, 0.0), "center_file": (0.0, 0.0, 0.0), "size_file": 1.0}


def test_the_slits_of_a_scan_are_closed_unless_unwanted():
    board = leaning_board(65.0)
    prior = GuessingPrior(TRUTH, NOTHING)
    found = complete(board, "a board", prior=prior, settings=GUESS, **SCAN)
    assert len(found.new) > 1000
    assert found.hard_preservation is not None
    assert found.hard_preservation.met
    assert any("splats close them" in note for note in found.notes)
    left = dataclasses.replace(GUESS, close_slits=False)
    assert len(complete(board, "a board", prior=prior, settings=left, **SCAN).new) == 0


def test_what_closes_slits_may_not_give_way_to_what_it_hides():
    """A wall close behind the board shows through its slits; bounds on P's look leave it there."""
    board = leaning_board(65.0)
    behind = dataclasses.replace(board, means=board.means - torch.tensor([0.05, 0.0, 0.0]))
    prior = GuessingPrior(TRUTH, FirstGuess(behind, ("behind",)))
    found = complete(board, "a board", prior=prior, settings=GUESS, **SCAN)
    slits = slit_splats(found.partial, found.views.eye())
    assert torch.equal(found.new.means[-len(slits) :], slits.means)
    assert torch.equal(found.new.opacities[-len(slits) :], slits.opacities)


def test_slits_stay_open_where_closing_them_breaks_the_bounds():
    strict = HardPreservationSettings(color_bound=1e-7, depth_bound=1e-7)
    settings = dataclasses.replace(GUESS, hard_preservation=strict)
    prior = GuessingPrior(TRUTH, NOTHING)
    found = complete(leaning_board(65.0), "a board", prior=prior, settings=settings, **SCAN)
    assert len(found.new) == 0
    assert any(note.startswith("slits of the scan: left open") for note in found.notes)


@pytest.mark.parametrize("least", [0.01, 0.5])
def test_a_part_of_one_colour_is_left_as_it_is_guessed(least):
    """The ball's colours differ by more than 0.01 from their mean and by less than 0.5."""
    settings = dataclasses.replace(DISTILL, steps=3, moves="colors", least_color_spread=least)
    prepared = prepare(PARTIAL, Request("a ball", settings), OraclePrior(TRUTH))
    assert prepared.steps.settings.steps == (3 if least < 0.1 else 0)
    assert any(
        note.startswith("no steps are taken: P has nearly one colour") for note in prepared.notes
    ) == (least > 0.1)


@pytest.mark.parametrize("count", [0, 400])
def test_an_unclean_part_is_told(count):
    lost = dataclasses.replace(TRUTH, means=TRUTH.means * 9).select(torch.arange(count))
    part = concatenate([PARTIAL, lost])
    heeding = dataclasses.replace(QUICK, leave_out_strays=False)
    requests = [Request("a ball", s, FramingRequest(**KNOWN)) for s in (heeding, QUICK)]
    notes, left_out = (prepare(part, request, OraclePrior(TRUTH)).notes for request in requests)
    assert any("strays beside the surface" in note for note in left_out) == bool(count)
    told = [note for note in notes if "may not belong" in note]
    assert len(told) == bool(count)
    assert all("floaters" in note for note in told)


@pytest.mark.parametrize("is_given", [True, False])
def test_only_a_guessed_view_gives_way_to_the_guess_of_the_complete_object(is_given, monkeypatch):
    part, wrong = half_cylinder(75.0), (255.0, 15.0)
    prior = GuessingPrior(TRUTH, FirstGuess(half_cylinder(255.0), ("not mirrored",)))
    framing = FramingRequest(
        view_deg=wrong if is_given else None, center_file=(0.0, 0.0, 0.0), size_file=1.0
    )
    if not is_given:
        views = prepare(
            part, Request("", GUESS, dataclasses.replace(framing, view_deg=wrong)), prior
        ).views
        decided = dataclasses.make_dataclass("Framing", ["frame", "views", "notes"])
        frame = prepare(part, Request("", GUESS, framing), prior).frame
        monkeypatch.setattr(
            "gscomplete.completion.pipeline.decide_framing",
            lambda *arguments, **more: decided(frame, views, ()),
        )
    prepared = prepare(part, Request("", GUESS, framing), prior)
    assert (prepared.views == prepared.guessed_views) == is_given
    assert any(note.startswith("input view changed to") for note in prepared.notes) == (
        not is_given
    )
    assert finish(prepared, part).views == prepared.views


def test_a_sphere_leaves_the_input_view_as_it_is():
    part = half_cylinder(75.0)
    request = Request("", RECONSTRUCT)
    prepared = prepare(part, request, OraclePrior(TRUTH))
    assert prepared.views == prepared.guessed_views


def test_a_view_that_does_not_show_p_is_refused():
    nothing = dataclasses.replace(PARTIAL, opacities=torch.zeros(len(PARTIAL)))
    with pytest.raises(UserError, match="expected splats visible from the input view"):
        complete(nothing, "a ball", prior=OraclePrior(TRUTH), settings=QUICK, **KNOWN)


class ShownPrior(OraclePrior):
    """Notes what it was asked to be shown."""

    def with_known_shape(self, conditioning, partial, distribution):
        return dataclasses.replace(conditioning, report=(*conditioning.report, "shown a shape"))


def test_a_known_shape_is_shown_where_p_is_withheld_and_known_shapes_are_wanted():
    framing = FramingRequest(**KNOWN)
    for sees, wanted in ((True, True), (False, True), (False, False)):
        settings = dataclasses.replace(QUICK, see_input=sees, known_shapes=wanted)
        prepared = prepare(PARTIAL, Request("a ball", settings, framing), ShownPrior(TRUTH))
        assert ("shown a shape" in prepared.notes) == (wanted and not sees)
