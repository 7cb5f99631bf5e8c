"""Depth of every coding gives the same points; flying pixels go; odd files give one message."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gscomplete.errors import UserError
from splatcomplete_data.singleview.depth_file import metric_depth, read_depth
from splatcomplete_data.singleview.intrinsics import read_intrinsics
from splatcomplete_data.singleview.load import SingleViewSettings, load_single_view
from splatcomplete_data.singleview.unproject import flying_pixels

HEIGHT, WIDTH = 24, 32


def plane() -> np.ndarray:
    """A slanted plane, 1 to 1.4 m away, with one unknown pixel."""
    depth = 1.0 + 0.4 * np.linspace(0, 1, WIDTH)[None].repeat(HEIGHT, 0)
    depth[3, 4] = np.nan
    return depth


def picture(folder: Path, mode: str = "RGB") -> Path:
    rng = np.random.default_rng(0)
    pixels = rng.integers(0, 255, (HEIGHT, WIDTH, len(mode))).astype(np.uint8)
    if mode == "RGBA":
        pixels[..., 3] = 0
        pixels[5:15, 5:15, 3] = 255
    Image.fromarray(pixels, mode).save(folder / "photo.png")
    return folder / "photo.png"


def write_depth(folder: Path, kind: str) -> Path:
    depth = plane()
    path = folder / f"depth.{kind}"
    if kind == "npy":
        np.save(path, depth.astype(np.float32))
    elif kind == "npz":
        np.savez(path, depth=depth[None].astype(np.float32), conf=np.ones((1, HEIGHT, WIDTH)))
    elif kind in ("png", "pgm"):
        Image.fromarray(np.nan_to_num(depth * 1000).round().astype(np.uint16)).save(path)
    else:
        oiio = pytest.importorskip("OpenImageIO")
        out = oiio.ImageOutput.create(str(path))
        out.open(str(path), oiio.ImageSpec(WIDTH, HEIGHT, 1, "float"))
        out.write_image(np.nan_to_num(depth).astype(np.float32)[..., None])
        out.close()
    return path


@pytest.mark.parametrize("kind", ["npy", "npz", "png", "pgm", "exr", "tif"])
def test_every_coding_gives_the_same_depth(tmp_path: Path, kind: str) -> None:
    image = read_depth(write_depth(tmp_path, kind))
    z, _ = metric_depth(image, "metric")
    np.testing.assert_allclose(z, plane(), atol=6e-4)
    assert np.isnan(z[3, 4])


def test_points_project_back_to_their_pixels(tmp_path: Path) -> None:
    settings = SingleViewSettings(focal_px=(40.0, 42.0), center_px=(15.5, 12.25), flying_jump=0)
    view = load_single_view(picture(tmp_path), write_depth(tmp_path, "npy"), settings)
    rows, columns = np.nonzero(view.kept)
    x, y, z = view.cloud.points.T
    np.testing.assert_allclose(40.0 * x / z + 15.5, columns + 0.5, atol=1e-9)
    np.testing.assert_allclose(42.0 * y / z + 12.25, rows + 0.5, atol=1e-9)
    np.testing.assert_allclose(z, plane()[rows, columns], rtol=1e-6)
    assert view.steps[0].reasons == {"unknown": 1}
    np.testing.assert_allclose(view.cloud.colors, view.color[rows, columns])


def test_a_grey_photo_of_16_bits_keeps_its_shades(tmp_path: Path) -> None:
    greys = np.linspace(0, 255, WIDTH).astype(np.uint16)[None].repeat(HEIGHT, 0)
    Image.fromarray(greys * 257).save(tmp_path / "photo.png")
    settings = SingleViewSettings(fov_deg=60.0)
    view = load_single_view(tmp_path / "photo.png", write_depth(tmp_path, "npy"), settings)
    np.testing.assert_allclose(view.color[..., 0] * 255, greys, atol=1e-4)


def test_disparity_and_inverse_depth() -> None:
    from splatcomplete_data.singleview.depth_file import DepthImage

    depth = plane()
    disparity = DepthImage(500 * 0.1 / depth - 7.0, False)
    z, _ = metric_depth(disparity, "disparity", focal_px=500, baseline=0.1, offset=7.0)
    np.testing.assert_allclose(z, depth)
    z, _ = metric_depth(DepthImage(2.0 / depth, False), "inverse", unit=2.0)
    np.testing.assert_allclose(z, depth)
    with pytest.raises(UserError, match="--baseline"):
        metric_depth(disparity, "disparity")


def test_flying_pixels_go_and_clean_edges_stay() -> None:
    depth = np.full((9, 12), 1.0)
    depth[:, 6:] = 2.0
    assert not flying_pixels(depth).any()
    depth[4, 6] = 1.5  # between near and far
    depth[2, 2] = 3.0  # alone
    marked = flying_pixels(depth)
    assert marked[4, 6]
    assert marked[2, 2]
    assert marked.sum() == 2
    depth[:, 9] = np.nan
    assert flying_pixels(depth).sum() == 2


@pytest.mark.parametrize(
    ("row", "flying"),
    [
        ([1.0, 1.0, 1.5, 2.0, 2.0], True),  # between a near and a far surface
        ([2.0, 2.0, 1.5, 1.0, 1.0], True),
        ([1.0, 1.0, 1.5, np.nan, np.nan], True),  # one side is unknown
        ([np.nan, np.nan, 1.5, 1.0, 1.0], True),
        ([2.0, 2.0, 1.0, 2.0, 2.0], False),  # a pole, one pixel wide
        ([1.0, 1.0, 2.0, 1.0, 1.0], False),  # a gap, one pixel wide
        ([np.nan, np.nan, 1.0, np.nan, np.nan], False),
    ],
)
def test_thin_things_stay_and_what_hangs_between_goes(row: list[float], flying: bool) -> None:
    marked = flying_pixels(np.array([row] * 5))
    assert marked[:, 2].tolist() == [flying] * 5
    assert not marked[:, [0, 1, 3, 4]].any()
    assert np.array_equal(flying_pixels(np.array([row] * 5).T), marked.T)


def test_masks_alpha_crop_range_and_confidence(tmp_path: Path) -> None:
    depth = write_depth(tmp_path, "npz")
    base = {"fov_deg": 60.0, "flying_jump": 0.0}
    photo = picture(tmp_path, "RGBA")
    assert load_single_view(photo, depth, SingleViewSettings(**base)).kept.sum() == 100  # type: ignore[arg-type]
    mask = np.zeros((HEIGHT * 2, WIDTH * 2), np.uint8)
    mask[:20, :20] = 255
    Image.fromarray(mask).save(tmp_path / "mask.png")
    for changes, count in (
        ({"mask": tmp_path / "mask.png"}, 99),
        ({"mask": tmp_path / "mask.png", "crop_px": (0, 0, 3, 50)}, 30),
        ({"mask": tmp_path / "mask.png", "far": 1.05}, 40),
        ({"mask": tmp_path / "mask.png", "min_confidence": 0.5}, 99),
    ):
        view = load_single_view(photo, depth, SingleViewSettings(**base, **changes))  # type: ignore[arg-type]
        assert view.kept.sum() == count
    for changes, message in (
        ({"near": 5.0}, "near_far"),
        ({"far": 0.0}, "near_far"),
        ({"min_confidence": 3.0}, "confidence"),
        ({"mask": tmp_path / "gone.png"}, "mask"),
    ):
        with pytest.raises(UserError, match=message):
            load_single_view(photo, depth, SingleViewSettings(**base, **changes))  # type: ignore[arg-type]


def test_depth_anything_results_are_read_as_they_are(tmp_path: Path) -> None:
    matrix = np.array([[[30.0, 0, 16], [0, 31, 12], [0, 0, 1]]])
    image = np.zeros((1, HEIGHT, WIDTH, 3), np.uint8)
    path = tmp_path / "results.npz"
    np.savez(path, image=image, depth=plane()[None], conf=plane()[None], intrinsics=matrix)
    view = load_single_view(None, path)
    assert (view.camera.focal_x_px, view.camera.focal_y_px) == (30.0, 31.0)
    np.savez(path, image=image, depth=plane()[None])
    with pytest.raises(UserError, match="--focal"):
        load_single_view(None, path)
    assert load_single_view(None, path, SingleViewSettings(fov_deg=50)).camera.width == WIDTH


def test_intrinsics_files_and_sizes(tmp_path: Path) -> None:
    path = tmp_path / "k.json"
    matrix = [525.0, 0, 0, 0, 526.0, 0, 319.5, 239.5, 1]
    path.write_text(json.dumps({"width": 640, "height": 480, "intrinsic_matrix": matrix}))
    found = read_intrinsics(path, 1, 1).resized(320, 240)
    assert (found.focal_x_px, found.focal_y_px, found.center_x_px) == (262.5, 263.0, 160.0)
    with pytest.raises(UserError, match="aspect"):
        found.resized(320, 320)
    for text in ("{}", "1 2 3", "[]", '{"fx": "a"}', '{"fx": -1}', '{"fx": 1, "w": 1e400}'):
        path.write_text(text)
        with pytest.raises(UserError, match="intrinsics"):
            read_intrinsics(path, 10, 10)


def test_odd_depth_files_are_user_errors(tmp_path: Path) -> None:
    photo = picture(tmp_path)
    cases = {
        "a.npy": lambda p: np.save(p, np.zeros((HEIGHT, WIDTH))),
        "b.npy": lambda p: np.save(p, np.ones((2, 3, 4, 5))),
        "c.npz": lambda p: np.savez(p, one=np.ones(3), two=np.ones(3)),
        "d.png": lambda p: Image.new("RGB", (WIDTH, HEIGHT)).save(p),
        "e.png": lambda p: Image.new("L", (WIDTH, HEIGHT), 9).save(p),
        "f.npy": lambda p: p.write_bytes(b"\x93NUMPY broken"),
        "g.jpg": lambda p: p.write_bytes(b"x"),
        "h.npy": lambda p: np.save(p, np.ones((30, 90))),
        "i.npy": lambda p: np.save(p, np.array(["a"])),
    }
    for name, write in cases.items():
        write(tmp_path / name)
        with pytest.raises(UserError, match="depth"):
            load_single_view(photo, tmp_path / name, SingleViewSettings(fov_deg=50))


def test_masks_of_other_kinds(tmp_path: Path) -> None:
    depth = write_depth(tmp_path, "npy")
    inside = np.zeros((HEIGHT, WIDTH), np.uint8)
    inside[10:20, 10:20] = 1
    opaque = np.dstack([inside * 255] * 3 + [np.full_like(inside, 255)])
    for pixels in (inside, opaque):
        Image.fromarray(pixels).save(tmp_path / "mask.png")
        settings = SingleViewSettings(fov_deg=60.0, mask=tmp_path / "mask.png", flying_jump=0.0)
        view = load_single_view(picture(tmp_path), depth, settings)
        np.testing.assert_array_equal(view.kept, inside > 0)
    Image.fromarray(inside * 0).save(tmp_path / "mask.png")
    with pytest.raises(UserError, match="only black"):
        load_single_view(picture(tmp_path), depth, settings)


def test_what_stands_for_infinity_is_unknown_and_counted(tmp_path: Path) -> None:
    depth = np.nan_to_num(plane(), nan=1e10).astype(np.float32)
    np.save(tmp_path / "blender.npy", depth)
    millimetres = np.nan_to_num(plane() * 1000, nan=65535).round().astype(np.uint16)
    Image.fromarray(millimetres).save(tmp_path / "sensor.png")
    for name in ("blender.npy", "sensor.png"):
        found = read_depth(tmp_path / name)
        assert np.isnan(found.values).sum() == 1
        assert found.notes == ("1 pixels hold a value for infinity; their depth is unknown",)


@pytest.mark.parametrize("largest", [4095, 10000, 65535])
def test_a_pgms_numbers_are_those_in_the_file(tmp_path: Path, largest: int) -> None:
    values = np.arange(100, 100 + HEIGHT * WIDTH, dtype=">u2").reshape(HEIGHT, WIDTH)
    head = f"P5 # a comment with 9 in it\n{WIDTH} {HEIGHT}\n{largest}\n".encode()
    (tmp_path / "a.pgm").write_bytes(head + values.tobytes())
    np.testing.assert_array_equal(read_depth(tmp_path / "a.pgm").values, values)


def test_pictures_of_bytes_are_no_depth(tmp_path: Path) -> None:
    oiio = pytest.importorskip("OpenImageIO")
    out = oiio.ImageOutput.create(str(tmp_path / "a.tif"))
    out.open(str(tmp_path / "a.tif"), oiio.ImageSpec(WIDTH, HEIGHT, 1, "uint8"))
    out.write_image(np.full((HEIGHT, WIDTH, 1), 9, np.uint8))
    out.close()
    Image.new("LA", (WIDTH, HEIGHT), (9, 255)).save(tmp_path / "a.png")
    for name in ("a.tif", "a.png"):
        with pytest.raises(UserError, match=r"expected (16 bits|one channel)"):
            read_depth(tmp_path / name)


@pytest.mark.parametrize(
    ("dtype", "message"),
    [
        ("u1", "expected 16 bits a pixel, found 8"),
        ("i1", "expected 16 bits a pixel, found 8"),
        ("c8", "expected real numbers, found complex64"),
        ("c16", "expected real numbers, found complex128"),
    ],
)
@pytest.mark.parametrize("suffix", ["npy", "npz"])
def test_arrays_of_bytes_or_complex_numbers_are_no_depth(
    tmp_path: Path, dtype: str, message: str, suffix: str
) -> None:
    values, path = np.full((HEIGHT, WIDTH), 100).astype(dtype), tmp_path / f"a.{suffix}"
    np.save(path, values) if suffix == "npy" else np.savez(path, depth=values)
    with pytest.raises(UserError, match=rf"a\.{suffix}: depth: {message}"):
        read_depth(path)


def test_pictures_of_floats_in_an_npz_are_not_black(tmp_path: Path) -> None:
    depth = plane()[None].astype(np.float32)
    np.savez(tmp_path / "a.npz", depth=depth, image=np.full((1, HEIGHT, WIDTH, 3), 0.4))
    color = read_depth(tmp_path / "a.npz").color
    assert color is not None
    assert (color == 102).all()


def test_units_of_disparities(tmp_path: Path) -> None:
    disparity = (500 * 0.1 / plane() * 256).round()
    Image.fromarray(np.nan_to_num(disparity).astype(np.uint16)).save(tmp_path / "kitti.png")
    found = read_depth(tmp_path / "kitti.png")
    z, _ = metric_depth(found, "disparity", unit=1 / 256, focal_px=500, baseline=0.1)
    np.testing.assert_allclose(z, plane(), rtol=1e-3)


def test_a_principal_point_alone_says_nothing(tmp_path: Path) -> None:
    settings = SingleViewSettings(center_px=(3.0, 4.0))
    with pytest.raises(UserError, match="--center-px"):
        load_single_view(picture(tmp_path), write_depth(tmp_path, "npy"), settings)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"fov_deg": 60.0, "intrinsics": Path("a.json")}, "--fov, --intrinsics: expected one of"),
        ({"focal_px": (9.0,), "intrinsics": Path("a.json")}, "--focal, --intrinsics: expected one"),
        ({"fov_deg": 60.0, "baseline": 0.1}, "--baseline: expected --kind disparity with it"),
        ({"fov_deg": 60.0, "disparity_offset": 1.0}, "--disparity-offset: expected --kind"),
        ({"fov_deg": 60.0, "flying_jump": -1.0}, "--flying: expected 0 or more, found -1"),
    ],
)
def test_settings_that_would_be_set_aside_are_refused(
    tmp_path: Path, settings: dict, message: str
) -> None:
    with pytest.raises(UserError, match=message):
        load_single_view(
            picture(tmp_path), write_depth(tmp_path, "npy"), SingleViewSettings(**settings)
        )
