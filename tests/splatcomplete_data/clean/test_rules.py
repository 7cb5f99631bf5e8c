"""Each rule marks what it is for, and leaves a clean surface alone."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from gscomplete.errors import UserError
from gscomplete.splats import Splats, concatenate, read_splats, write_splats
from gscomplete.splats.formats import glb
from splatcomplete_data.clean.rules import DEFAULT_RULES, clean_rows, islands, limits_at
from splatcomplete_data.cli import main
from splatcomplete_data.multiview.propose_box import focus_of_splats
from tests.builders.objects import BALL


def moved(splats: Splats, shift: tuple[float, float, float], size: float = 1.0) -> Splats:
    return dataclasses.replace(
        splats, means=size * splats.means + torch.tensor(shift), scales=size * splats.scales
    )


def first(count: int, **changes: torch.Tensor) -> Splats:
    return dataclasses.replace(BALL.select(torch.arange(count)), **changes)


def dirty() -> tuple[Splats, dict[str, int]]:
    """A ball, and ten of each kind that do not belong to it."""
    generator = torch.Generator().manual_seed(4)
    away = torch.nn.functional.normalize(torch.randn(10, 3, generator=generator), dim=1)
    near = 0.5 * away
    large, long = torch.full((10, 3), 0.6), torch.tensor([0.2, 0.002, 0.002]).repeat(10, 1)
    wide = torch.full((10, 3), 0.15)
    parts = {
        "floaters": first(10, means=2.5 * away),
        "giants": first(10, means=near, scales=large),
        "haze": first(10, means=near, scales=wide, opacities=torch.full((10,), 0.03)),
        "needles": first(10, means=near, scales=long),
        "islands": moved(BALL.select(torch.arange(0, 4000, 16)), (0.9, 0.0, 0.0), 0.1).select(
            torch.arange(40)
        ),
    }
    return concatenate([BALL, *parts.values()]), {name: len(part) for name, part in parts.items()}


def test_each_rule_finds_its_own():
    splats, expected = dirty()
    cleaned = clean_rows(splats, 0.5)
    assert cleaned.reasons == expected
    assert cleaned.keep[: len(BALL)].all()
    assert not cleaned.keep[len(BALL) :].any()
    for rule in DEFAULT_RULES:
        alone = clean_rows(splats, 0.5, [rule]).reasons
        assert alone.get(rule, 0) >= expected[rule]
        assert set(alone) <= {rule}


@pytest.mark.parametrize("strength", [0.01, 0.5, 1.0])
def test_a_clean_surface_stays(strength):
    assert clean_rows(BALL, strength).keep.all()


def test_more_strength_marks_more():
    splats, _ = dirty()
    kept = [int(clean_rows(splats, strength).keep.sum()) for strength in (0.0, 0.2, 0.5, 0.8, 1.0)]
    assert kept == sorted(kept, reverse=True)
    assert kept[0] == len(splats)
    gentle, strict = limits_at(0.25), limits_at(0.75)
    for field in dataclasses.fields(gentle):
        is_more = field.name == "haze_opacity"
        assert (getattr(gentle, field.name) > getattr(strict, field.name)) != is_more


def test_rows_that_cannot_be_drawn_go_at_any_strength():
    means = BALL.means.clone()
    means[7] = float("nan")
    cleaned = clean_rows(dataclasses.replace(BALL, means=means), 0.0)
    assert cleaned.reasons == {"non_finite_mean": 1}
    assert not cleaned.keep[7]


def test_what_is_far_from_all_others_is_an_island_however_much_it_holds():
    """What ``validate`` warns of as position outliers."""
    far = moved(BALL.select(torch.arange(0, len(BALL), 50)), (60.0, 0.0, 0.0))
    cleaned = clean_rows(concatenate([BALL, far]), 0.5)
    assert cleaned.keep[: len(BALL)].all()
    assert not cleaned.keep[len(BALL) :].any()


def test_a_splat_that_reaches_over_joins_islands():
    """A stick of long splats ties a small ball to a large one."""
    # The stick ends in its middle, within reach of its splats.
    small = moved(BALL.select(torch.arange(0, 4000, 100)), (0.9, 0.0, 0.0), 0.04)
    small = dataclasses.replace(small, scales=2.5 * small.scales)
    apart = concatenate([BALL, small])
    assert islands(apart, 0.5).sum() == 40
    stick = first(
        1,
        means=torch.tensor([[0.7, 0.0, 0.0]]),
        scales=torch.tensor([[0.2 / 1.5, 0.01, 0.01]]),
        quaternions=torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
    )
    tied = concatenate([apart, stick])
    assert islands(tied, 0.5).sum() == 0


def test_background_is_the_table_and_what_lies_under_it():
    generator = torch.Generator().manual_seed(3)
    place = 4 * torch.rand(1500, 3, generator=generator) - 2
    place[:, 2] = -0.6
    table = dataclasses.replace(
        BALL.select(torch.arange(1500)),
        means=place,
        scales=torch.tensor([0.1, 0.1, 0.001]).repeat(1500, 1),
        quaternions=torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(1500, 1),
    )
    splats = concatenate([BALL, table, moved(table.select(torch.arange(200)), (0.0, 0.0, -0.3))])
    focus = focus_of_splats(splats, np.array([0.0, 0.0, 1.0]))
    cleaned = clean_rows(splats, 0.5, ["background"], focus)
    assert cleaned.keep[: len(BALL)].mean() > 0.98  # its lowest splats touch the table's haze
    assert not cleaned.keep[len(BALL) :].any()
    with pytest.raises(UserError, match="expected to know where the object is"):
        clean_rows(splats, 0.5, ["background"])


def test_the_command_copies_records_and_tells_counts(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    splats, expected = dirty()
    write_splats("a.ply", splats, ("a comment",))
    assert main(["clean", "a.ply", "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["removed"] == expected
    assert content["kept"] == len(BALL)
    assert (tmp_path / "clean.png").stat().st_size > 1000
    assert main(["clean", "a.ply", "--out", "b.ply"]) == 0
    source, result = read_splats("a.ply"), read_splats("b.ply")
    rows = source.payload.records.reshape(len(splats), -1)[: len(BALL)]
    assert result.payload.records.tobytes() == rows.tobytes()
    assert result.comments == ("a comment",)
    assert main(["clean", "a.ply", "--out", "b.ply"]) == 2
    assert "it exists" in capsys.readouterr().err
    (tmp_path / "b.ply").unlink()
    assert main(["clean", "a.ply", "--out", "b.ply"]) == 2
    assert "b.png: it exists; replace it with --overwrite" in capsys.readouterr().err
    assert main(["clean", "a.ply", "--out", "b.ply", "--overwrite"]) == 0
    Path("mine.png").write_text("mine")
    assert main(["clean", "a.ply", "--picture", "mine.png"]) == 2
    assert "mine.png: it exists; replace it with --overwrite" in capsys.readouterr().err
    assert Path("mine.png").read_text() == "mine"
    Path("clean.png").write_text("mine")
    assert main(["clean", "a.ply"]) == 2
    assert "clean.png: would be replaced, but was not drawn by this" in capsys.readouterr().err
    assert Path("clean.png").read_text() == "mine"
    Path("clean.png").unlink()
    assert main(["clean", "a.ply", "--strength", "2"]) == 2
    assert "--strength: expected 0 to 1, found 2" in capsys.readouterr().err
    assert main(["clean", "a.ply", "--out", "c.sog", "--rules", "haze", "--strength", "0.4"]) == 0
    assert "lost: values are quantised" in capsys.readouterr().out


def test_what_is_up_is_y_in_a_glb(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tall = BALL.select(BALL.means[:, 2] > 0)
    write_splats(tmp_path / "a.ply", tall)
    for up, expected in (("Z", (0.0, 0.5)), ("-Z", (-0.5, 0.0))):
        words = ["clean", "a.ply", "--strength", "0", f"--up={up}", "--out", f"up{up}.glb"]
        assert main(words) == 0
        found, _ = glb.read_glb_splats(tmp_path / f"up{up}.glb")
        y = found.means[:, 1]
        # heights on a ball are uniform: the outermost of 4000 lie some 1 / 4000 inside
        assert (float(y.min()), float(y.max())) == pytest.approx(expected, abs=4 / 4000)
