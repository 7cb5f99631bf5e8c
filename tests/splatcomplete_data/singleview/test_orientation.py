"""A photo with an EXIF rotation goes with its depth whichever way that was made."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image, ImageOps

from gscomplete.errors import UserError
from splatcomplete_data import cli
from splatcomplete_data.multiview.photos.images import shown_axes
from splatcomplete_data.singleview.load import SingleViewSettings, load_single_view

STORED = (32, 24)
"""Width and height of the stored pixels."""
SETTINGS = SingleViewSettings(fov_deg=60.0)
QUARTER_TURNS = (5, 6, 7, 8)
CAMERA_AXES = {(0, -1): "-Y", (0, 1): "Y", (1, 0): "X", (-1, 0): "-X"}


def photo(folder: Path, tag: int, size: tuple[int, int] = STORED) -> Path:
    pixels = np.random.default_rng(0).integers(0, 256, (size[1], size[0], 3)).astype(np.uint8)
    image = Image.fromarray(pixels)
    exif = image.getexif()
    exif[ExifTags.Base.Orientation] = tag
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = 28
    image.save(folder / "photo.png", exif=exif)
    return folder / "photo.png"


def depth(folder: Path, width: int, height: int) -> Path:
    np.save(folder / "depth.npy", np.full((height, width), 2.0))
    return folder / "depth.npy"


@pytest.mark.parametrize("tag", QUARTER_TURNS)
def test_depth_of_the_shown_photo_takes_its_turned_pixels(tmp_path, tag):
    path = photo(tmp_path, tag)
    view = load_single_view(path, depth(tmp_path, 24, 32), SETTINGS)
    turned = np.asarray(ImageOps.exif_transpose(Image.open(path)))
    np.testing.assert_allclose(view.color, turned / np.float32(255), atol=1e-6)
    assert view.up == "-Y"
    assert (
        f"the photo's EXIF rotation ({tag}) is applied, as the turned photo has the depth's"
        in view.notes[0]
    )
    # the focal length that EXIF tells is one of the longer side, whichever that is
    assert load_single_view(path, tmp_path / "depth.npy").camera.focal_x_px == pytest.approx(
        28 / 36 * 32
    )


@pytest.mark.parametrize("tag", range(1, 9))
def test_depth_of_the_stored_pixels_keeps_them_and_knows_up(tmp_path, tag):
    path = photo(tmp_path, tag)
    view = load_single_view(path, depth(tmp_path, 16, 12), SETTINGS)
    stored = Image.open(path).resize((16, 12), Image.Resampling.BOX)
    np.testing.assert_allclose(view.color, np.asarray(stored) / np.float32(255), atol=1e-6)
    assert view.up == CAMERA_AXES[shown_axes(path)[1]]
    told = any(f"EXIF rotation ({tag})" in note for note in view.notes)
    assert told == (tag != 1)
    if tag != 1:
        is_sure = any("is not applied, as the stored pixels have" in note for note in view.notes)
        assert is_sure == (tag in QUARTER_TURNS)


@pytest.mark.parametrize(("tag", "side"), [(6, 24), (3, 32)])
def test_where_both_fit_the_stored_pixels_are_assumed(tmp_path, tag, side):
    path = photo(tmp_path, tag, (side, 24))
    view = load_single_view(path, depth(tmp_path, side, 24), SETTINGS)
    stored = np.asarray(Image.open(path))
    np.testing.assert_allclose(view.color, stored / np.float32(255), atol=1e-6)
    assert (
        "fits with and without it, and is assumed to be that of the stored pixels" in view.notes[0]
    )


@pytest.mark.parametrize("is_shown", [True, False])
def test_of_two_that_nearly_fit_the_nearer_is_taken(tmp_path, is_shown):
    path = photo(tmp_path, 6, (200, 198))
    size = (198, 200) if is_shown else (200, 198)
    view = load_single_view(path, depth(tmp_path, *size), SETTINGS)
    assert view.up == ("-Y" if is_shown else CAMERA_AXES[shown_axes(path)[1]])


def test_aspect_errors_name_the_rotation(tmp_path):
    path = depth(tmp_path, 50, 20)
    with pytest.raises(UserError, match="found 32 x 24 pixels, or 24 x 32 turned as its EXIF says"):
        load_single_view(photo(tmp_path, 6), path, SETTINGS)
    path = depth(tmp_path, 24, 32)
    with pytest.raises(
        UserError, match="it fits if turned by 90 degrees, but has no EXIF rotation"
    ):
        load_single_view(photo(tmp_path, 1), path, SETTINGS)


@pytest.mark.parametrize(("given", "up"), [([], "-X"), (["--up", "X"], "X"), (["--level"], "Z")])
def test_the_command_takes_up_from_it_unless_told(tmp_path, given, up):
    words = ["depth", str(photo(tmp_path, 6)), str(depth(tmp_path, *STORED)), "--fov", "60"]
    if "--level" in given:
        values = np.full(STORED[::-1], 2.0)
        values[5:10, 5:10] = 1.5
        np.save(tmp_path / "depth.npy", values)
    out = tmp_path / "out"
    assert cli.main([*words, "--no-outliers", *given, "--out", str(out)]) == 0
    assert json.loads((out / "object.json").read_text())["frame"]["up"] == up
