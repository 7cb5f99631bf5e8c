from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image, ImageOps

from gscomplete.errors import UserError
from splatcomplete_data.multiview.photos.colmap_model import read_colmap
from splatcomplete_data.multiview.photos.images import (
    list_photos,
    load_views,
    orientation_note,
    photo_size,
    read_photo,
    scaled_size,
    shown_axes,
)
from splatcomplete_data.multiview.photos.posed import PosedPhotos
from splatcomplete_data.multiview.photos.transforms_json import read_transforms
from splatcomplete_data.multiview.sfm.structure_from_motion import find_poses
from tests.builders import captures


def posed(folder: Path, **values: object) -> PosedPhotos:
    return read_transforms(captures.transforms_capture(folder, 3, **values) / "transforms.json")


def masks(folder: Path, count: int = 3, size: int = captures.SIZE_PX) -> Path:
    """Masks whose left half is white."""
    folder.mkdir(parents=True)
    pixels = np.zeros((size, size), np.uint8)
    pixels[:, : size // 2] = 255
    for index in range(count):
        Image.fromarray(pixels).save(folder / f"photo_{index:02}.png")
    return folder


def test_views_keep_colours_and_scale_the_camera(tmp_path):
    capture = posed(tmp_path)
    whole = load_views(capture, max_side_px=100)[0]
    half = load_views(capture, max_side_px=16)[0]
    stored = np.asarray(Image.open(capture.photos[0].path))
    np.testing.assert_array_equal(whole.colors, stored)
    assert (half.camera.width, half.camera.height) == (16, 16)
    np.testing.assert_allclose(half.camera.focal_px, whole.camera.focal_px / 2)
    blocks = stored.reshape(16, 2, 16, 2, 3).mean(axis=(1, 3))
    assert np.abs(half.colors - blocks).max() <= 1.01  # Pillow rounds after rows and columns
    assert (whole.weight == 255).all()
    assert whole.alpha is None


def test_undistorted_edges_do_not_count(tmp_path):
    folder = captures.transforms_capture(tmp_path, 3)
    views = captures.cameras(3)
    names = [f"photo_{i:02}.png" for i in range(3)]
    captures.transforms_file(folder / "transforms.json", views, names, k1=0.3)
    view = load_views(read_transforms(folder / "transforms.json"), max_side_px=100)[0]
    assert view.weight[0, 0] == 0
    assert view.weight[16, 16] == 255


@pytest.mark.parametrize("tag", range(1, 9))
def test_shown_axes_are_those_of_the_turned_picture(tmp_path, tag):
    pixels = np.zeros((9, 15), np.uint8)
    pixels[4, 7] = 255
    stored = Image.fromarray(pixels)
    exif = stored.getexif()
    exif[ExifTags.Base.Orientation] = tag
    stored.save(tmp_path / "a.png", exif=exif)
    (right, up) = shown_axes(tmp_path / "a.png")
    for (step_x, step_y), (dx, dy) in ((right, (3, 0)), (up, (0, -3))):
        moved = np.zeros_like(pixels)
        moved[4 + 3 * step_y, 7 + 3 * step_x] = 255
        image = Image.fromarray(moved)
        image.getexif()[ExifTags.Base.Orientation] = tag
        shown = np.asarray(ImageOps.exif_transpose(image))
        middle = np.array(shown.shape) // 2
        assert shown[middle[0] + dy, middle[1] + dx] == 255


def test_turned_photos_are_noted_and_keep_their_pixels(tmp_path):
    capture = posed(tmp_path)
    paths = [photo.path for photo in capture.photos]
    before = read_photo(paths[1])
    assert orientation_note(paths) is None
    image = Image.open(paths[1])
    exif = image.getexif()
    exif[ExifTags.Base.Orientation] = 6
    image.save(paths[1], exif=exif)
    note = orientation_note(paths)
    assert note is not None
    assert note.startswith("1 of 3 photos carry an EXIF rotation (first: photo_01.png)")
    np.testing.assert_array_equal(read_photo(paths[1]), before)
    assert orientation_note([tmp_path / "none.jpg"]) is None  # reported where it is loaded


def test_alpha_channels_become_object_masks(tmp_path):
    view = load_views(posed(tmp_path, alpha=True), max_side_px=100)[0]
    assert view.alpha is not None
    assert view.alpha[16, 16] > 250
    assert view.alpha[0, 0] == 0


def test_masks_restrict_to_the_object_or_leave_pixels_out(tmp_path):
    capture, folder = posed(tmp_path / "c"), masks(tmp_path / "masks")
    thing = load_views(capture, max_side_px=100, masks=folder)[0]
    assert thing.alpha is not None
    assert (thing.alpha[:, :16] == 255).all()
    assert (thing.alpha[:, 16:] == 0).all()
    assert (thing.weight == 255).all()
    ignore = load_views(capture, max_side_px=100, masks=folder, mask_means="ignore")[0]
    assert ignore.alpha is None
    assert (ignore.weight[:, 16:] == 0).all()


def test_masks_of_0_and_1_are_black_and_white(tmp_path):
    capture, folder = posed(tmp_path / "c"), masks(tmp_path / "masks")
    for path in folder.iterdir():
        Image.fromarray(np.asarray(Image.open(path)) // 255).save(path)
    thing = load_views(capture, max_side_px=100, masks=folder)[0]
    assert thing.alpha is not None
    assert (thing.alpha[:, :16] == 255).all()
    assert (thing.alpha[:, 16:] == 0).all()


def test_a_missing_mask_and_one_of_another_size_are_named(tmp_path):
    capture = posed(tmp_path / "c")
    with pytest.raises(UserError, match=r"found none for photo_02\.png"):
        load_views(capture, max_side_px=100, masks=masks(tmp_path / "two", 2))
    with pytest.raises(UserError, match="32 x 32, found 20 x 20"):
        load_views(capture, max_side_px=100, masks=masks(tmp_path / "small", 3, 20))


def test_masks_of_photos_in_folders_lie_in_folders_too(tmp_path):
    capture = read_transforms(captures.nested_capture(tmp_path / "c"))
    for name, shade in zip(capture.names, range(8), strict=True):
        (tmp_path / "masks" / name).parent.mkdir(parents=True, exist_ok=True)
        Image.new("L", (32, 32), 10 * shade).save(tmp_path / "masks" / name)
    views = load_views(capture, max_side_px=100, masks=tmp_path / "masks")
    assert [view.name for view in views] == list(capture.names)
    assert [int(view.alpha[0, 0]) for view in views] == [10 * shade for shade in range(8)]
    (tmp_path / "masks/right/0002.png").unlink()
    with pytest.raises(UserError, match=r"found none for right/0002\.png"):
        load_views(capture, max_side_px=100, masks=tmp_path / "masks")


def test_more_pixels_than_a_photo_has_are_a_message(tmp_path):
    posed(tmp_path / "c")
    photo = tmp_path / "c/images/photo_01.png"
    captures.colmap_model(
        tmp_path / "c/sparse/0",
        captures.cameras(3),
        [f"photo_{i:02}.png" for i in range(3)],
        text=True,
    )
    captures.huge_picture(photo)
    for read in (
        lambda: read_photo(photo),
        lambda: photo_size(photo),
        lambda: read_transforms(tmp_path / "c/transforms.json"),
        lambda: read_colmap(tmp_path / "c/sparse/0", tmp_path / "c/images"),
        lambda: find_poses(tmp_path / "c/images", tmp_path / "w"),
    ):
        with pytest.raises(UserError, match=r"photo_01\.png: more pixels than a photo has"):
            read()
    assert shown_axes(photo) == ((1, 0), (0, -1))  # loading its pixels is what reports it


def test_some_masks_are_not_enough(tmp_path):
    capture = posed(tmp_path, alpha=True)
    path = capture.photos[1].path
    Image.open(path).convert("RGB").save(path)
    with pytest.raises(UserError, match="found 2 masks for 3 photos"):
        load_views(capture, max_side_px=100)


def test_damaged_and_foreign_files_are_named(tmp_path):
    path = tmp_path / "a.png"
    path.write_bytes(b"")
    with pytest.raises(UserError, match=r"a\.png: cannot read it as a picture"):
        read_photo(path)
    Image.new("RGB", (40, 40)).save(path)
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(UserError, match=r"a\.png"):
        read_photo(path)


def test_a_photo_that_changed_its_size_is_named(tmp_path):
    capture = posed(tmp_path)
    Image.new("RGB", (9, 9)).save(capture.photos[0].path)
    with pytest.raises(UserError, match="expected 32 x 32 pixels as its camera has, found 9 x 9"):
        load_views(capture, max_side_px=100)


def test_empty_and_missing_folders_are_named(tmp_path):
    with pytest.raises(UserError, match="expected photos"):
        list_photos(tmp_path)
    with pytest.raises(UserError, match="expected a folder"):
        list_photos(tmp_path / "none")


def test_grey_and_palette_photos_are_read_as_rgb(tmp_path):
    for mode in ("L", "P", "CMYK", "I;16"):
        path = tmp_path / f"{mode[0]}.tif"
        Image.new(mode, (4, 3)).save(path)
        assert read_photo(path).shape == (3, 4, 3)


def test_greys_of_16_bits_keep_their_shades(tmp_path):
    greys = np.array([[0, 64], [128, 255]], np.uint16)
    Image.fromarray(greys * 257).save(tmp_path / "a.png")
    np.testing.assert_array_equal(read_photo(tmp_path / "a.png"), np.dstack([greys] * 3))


def test_scaling_never_enlarges():
    assert scaled_size(1080, 1920, 480) == (270, 480)
    assert scaled_size(10, 20, 480) == (10, 20)
    assert scaled_size(3000, 1, 100) == (100, 1)
