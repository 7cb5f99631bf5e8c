"""Pictures have the right size and content, and files appear whole or not at all."""

from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from gscomplete.errors import UserError
from gscomplete.evaluate import (
    contact_sheet,
    draw_turntable,
    preview_sheet,
    render_images,
    save_image,
    save_turntable,
)
from gscomplete.evaluate import pictures as module
from gscomplete.evaluate.pictures import LIGHT_GREY, require_own_picture, to_image
from gscomplete.splats import Splats
from gscomplete.views import ViewDistribution
from tests.builders.objects import round_splats


def red_blob() -> Splats:
    means = 0.2 * torch.randn(50, 3, generator=torch.Generator().manual_seed(0))
    return round_splats(means, scale=0.1, opacity=1.0, color=(1.0, 0.0, 0.0))


def test_to_image_rounds_and_clamps() -> None:
    colors = torch.tensor([[[-1.0, 0.0, 2.0], [0.5, 1 / 255, 0.9999]]])
    assert np.asarray(to_image(colors)).tolist() == [[[0, 0, 255], [128, 1, 255]]]


def test_sheet_holds_every_picture_unchanged() -> None:
    pictures = [Image.new("RGB", (30, 20), (10 * i, 0, 0)) for i in range(6)]
    sheet = contact_sheet(
        [pictures[:3], pictures[3:]],
        row_labels=["input", "a longer label"],
        column_labels=["a", "b", "c"],
        title="title",
    )
    colors = sheet.getcolors(100_000) or []
    counts = {color: count for count, color in colors}
    for index in range(1, 6):
        assert counts[(10 * index, 0, 0)] == 600


def test_sheet_without_labels_is_just_the_pictures() -> None:
    assert contact_sheet([[Image.new("RGB", (8, 8))] * 2]).size == (4 + 2 * 12, 4 + 12)


def test_sheet_checks_its_labels() -> None:
    picture = Image.new("RGB", (8, 8))
    with pytest.raises(ValueError, match="row_labels: expected 1, found 2"):
        contact_sheet([[picture]], row_labels=["a", "b"])
    with pytest.raises(ValueError, match="none"):
        contact_sheet([[]])


@pytest.fixture
def small_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Turntables of twelve small pictures."""
    monkeypatch.setattr(module, "_TURN_FRAMES", 12)
    monkeypatch.setattr(module, "_TURN_PX", 32)


@pytest.mark.usefixtures("small_turn")
def test_preview_shows_input_and_completion_from_six_views(tmp_path: Path) -> None:
    blob, views = red_blob(), ViewDistribution(30, 15)
    turn = draw_turntable(blob, views)
    again = render_images(blob, views.preview_cameras(32))
    assert [p.tobytes() for p in turn[::2]] == [p.tobytes() for p in again]
    sheet = preview_sheet(blob.select(torch.arange(10)), turn, views, title="x")
    assert sheet == contact_sheet(
        [render_images(blob.select(torch.arange(10)), views.preview_cameras(32)), again],
        row_labels=["input", "completion"],
        column_labels=["c (input view)", *(f"c + {60 * k}" for k in range(1, 6))],
        title="x",
    )
    assert sheet.width > 6 * 32
    assert sheet.height > 2 * 32
    path = tmp_path / "preview.png"
    save_image(sheet, path)
    assert Image.open(path).size == sheet.size


def test_only_own_pictures_are_replaced_unasked(tmp_path: Path) -> None:
    path, picture = tmp_path / "a.png", Image.new("RGB", (4, 4))
    require_own_picture(path)
    save_image(picture, path)
    require_own_picture(path)
    picture.save(path)
    with pytest.raises(UserError, match="not drawn by this program"):
        require_own_picture(path)
    path.write_text("notes")
    with pytest.raises(UserError, match="not drawn by this program"):
        require_own_picture(path)


def test_rendered_background_is_light_grey() -> None:
    image = render_images(red_blob(), ViewDistribution(0, 0).input_camera(32))[0]
    expected = tuple(round(255 * c) for c in LIGHT_GREY)
    assert image.getpixel((0, 0)) == expected
    red, green, _ = image.getpixel((16, 16))  # type: ignore[misc]
    assert red > green + 50


@pytest.mark.usefixtures("small_turn")
@pytest.mark.parametrize("suffix", [".webp", ".gif"])
def test_turntable_turns_once_and_loops(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"turntable{suffix}"
    turn = draw_turntable(red_blob(), ViewDistribution(0, 0))
    save_turntable(turn, path)
    with Image.open(path) as animation:
        assert animation.n_frames == 12  # type: ignore[attr-defined]
        assert animation.size == (32, 32)
        assert animation.info["loop"] == 0
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_unknown_suffixes_are_user_errors(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"\.mp4"):
        save_turntable([Image.new("RGB", (2, 2))], tmp_path / "a.mp4")
    with pytest.raises(UserError, match=r"\.xyz"):
        save_image(Image.new("RGB", (2, 2)), tmp_path / "a.xyz")
    with pytest.raises(UserError, match="folder"):
        save_image(Image.new("RGB", (2, 2)), tmp_path / "none" / "a.png")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("title", ["word " * 5000, "x" * 300, "two\nlines"])
def test_long_titles_end_in_dots_and_are_one_line(title: str) -> None:
    grid = [[Image.new("RGB", (100, 20))] * 6]
    sheet = contact_sheet(grid, title=title)
    assert sheet.size == contact_sheet(grid, title="short").size
