"""Known shapes are fitted once per part and named by what users are told."""

from pathlib import Path

import numpy as np
import pytest

from gscomplete.shape.bank import known as known_module
from gscomplete.shape.bank.as_answer import DECIDING
from gscomplete.shape.bank.fit import FitLimits, FittedShape, fit_known_shapes
from gscomplete.shape.bank.known import MOST_SHOWN, KnownShapes
from gscomplete.shape.bank.pose import Pose
from gscomplete.shape.bank.store import BANK_CELLS, BANK_FILE, ShapeName, read_bank, write_bank
from gscomplete.splats import Splats
from gscomplete.views import ViewDistribution
from tests.builders.known_shapes import box_cells, cell_points, chair_cells
from tests.builders.objects import moved, round_splats

NAMES = (
    ShapeName("a/chair", "chair", "a chair"),
    ShapeName("b/cube", "chair", "no chair at all"),
    ShapeName("c/plank", "plank", "a plank"),
    ShapeName("c/shelf", "shelf", "a shelf like a plank"),
)
VIEWS = ViewDistribution(0.0, 15.0)


@pytest.fixture(scope="module")
def bank(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bank") / BANK_FILE
    plank = box_cells((48, 8, 3), at=(0, 20, 22))
    write_bank(path, NAMES, [chair_cells(), box_cells((48, 48, 48)), plank, plank])
    return path


@pytest.fixture(autouse=True)
def _nothing_fitted_yet() -> None:
    known_module._fitted.cache_clear()


@pytest.fixture(scope="module")
def part() -> Splats:
    """The upper part of a chair."""
    whole = cell_points(chair_cells())
    return round_splats(whole[whole[:, 2] > 0.0], scale=0.01)


def shape(name: str) -> FittedShape:
    """Return a fitted shape of which only the name counts."""
    nothing = np.zeros((BANK_CELLS,) * 3, bool)
    pose = Pose(0.0, np.ones(3), np.zeros(3))
    return FittedShape(ShapeName(name, "", ""), nothing, pose, np.zeros((1, 3)), 0, 0, 0, 0)


@pytest.mark.parametrize(("decide", "limits"), [(False, FitLimits()), (True, DECIDING)])
def test_shapes_are_those_of_the_fit_under_the_limits_in_use(bank, part, decide, limits):
    found = KnownShapes(bank, "a wooden chair", decide).fitted(part, VIEWS)
    expected = fit_known_shapes(
        read_bank(bank), "a wooden chair", part.means.double().numpy(), VIEWS.direction(),
        MOST_SHOWN, limits,
    )  # fmt: skip
    assert [(s.name, s.cost) for s in found] == [(s.name, s.cost) for s in expected]
    assert found[0].name.id == "a/chair"
    assert np.array_equal(found[0].points, expected[0].points)
    assert len(found) == (2 if decide else 1)  # the cube fits under the wide limits alone


def test_a_part_is_fitted_once_and_whatever_differs_again(bank, part, monkeypatch):
    calls = []
    monkeypatch.setattr(known_module, "fit_known_shapes", lambda *given: calls.append(given) or [])
    known = KnownShapes(bank, "a chair")
    known.fitted(part, VIEWS)
    assert KnownShapes(bank, "a chair").fitted(part, VIEWS) == ()
    assert len(calls) == 1
    others = (
        (known, part, ViewDistribution(90.0, 15.0)),
        (known, moved(part, (0.1, 0.0, 0.0)), VIEWS),
        (KnownShapes(bank, "a plank"), part, VIEWS),
        (KnownShapes(bank, "a chair", decide=True), part, VIEWS),
    )
    for number, (each, splats, views) in enumerate(others, 2):
        each.fitted(splats, views)
        assert len(calls) == number
    _, prompt, points, toward_c, count, limits = calls[2]
    assert (prompt, count, limits) == ("a chair", MOST_SHOWN, FitLimits())
    assert np.array_equal(points, moved(part, (0.1, 0.0, 0.0)).means.double().numpy())
    assert np.array_equal(toward_c, VIEWS.direction())


def test_without_a_bank_nothing_is_known(part):
    known = KnownShapes(None, "a chair")
    assert known.fitted(part, VIEWS) == ()
    assert known.may_agree() is False
    assert known.notes(()) == known.notes((shape("a/chair"),)) == ()


@pytest.mark.parametrize("prompt", ["a unicorn", "", "a chair"])
def test_parts_without_extent_and_names_without_shapes_fit_nothing(bank, part, prompt):
    point = part.select(slice(0, 1)) if prompt == "a chair" else part
    assert KnownShapes(bank, prompt).fitted(point, VIEWS) == ()


@pytest.mark.parametrize(
    ("prompt", "expected"),
    [
        ("a chair", True),
        ("two chairs", True),
        ("a plank", False),  # two shapes of one pack
        ("a unicorn", False),
        ("", False),
    ],
)
def test_shapes_may_agree_if_two_packs_have_them(bank, prompt, expected):
    assert KnownShapes(bank, prompt).may_agree() is expected


USED = (shape("a/chair"), shape("b/cube"))


@pytest.mark.parametrize(
    ("prompt", "decide", "used", "note"),
    [
        ("a red chair", False, USED, "chair: known shapes used: a/chair, b/cube (--no-known"),
        ("a red chair", True, USED[:1], "chair: P becomes the known shape that fits it best, a/c"),
        ("a red chair", False, (), "chair: known shapes not used: they do not fit P, disagree"),
        ("a red chair", True, (), "chair: no known shape fits P, so P is completed without one"),
        ("a unicorn", False, (), "unicorn: no known shape has this name"),
        ("a unicorn", True, (), "unicorn: no known shape has this name"),
    ],
)
def test_users_are_told_which_shapes_were_used_or_why_none(bank, prompt, decide, used, note):
    (told,) = KnownShapes(bank, prompt, decide).notes(used)
    assert told.startswith(note)


@pytest.mark.parametrize("prompt", ["", "  ", "an object"])
def test_prompts_without_a_noun_say_nothing(bank, prompt):
    assert KnownShapes(bank, prompt).notes(()) == ()


def test_contradictions_say_how_many_splats_which_shapes_lack():
    told = KnownShapes(None, "a red chair").contradiction(USED, 12345)
    assert told == (
        "chair: 12,345 mirrored splats left out, as no known shape has them (a/chair, b/cube) "
        "(--no-known-shapes keeps them)"
    )
