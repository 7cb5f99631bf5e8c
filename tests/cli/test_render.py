"""``gscomplete render`` on real files."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from gscomplete.cli.guard import run_guarded
from gscomplete.cli.render import RenderOptions, run
from gscomplete.errors import UserError
from gscomplete.splats import read_splats, write_splats
from gscomplete.views import ObjectFrame
from tests.builders.commands import SAMPLE
from tests.builders.folders import write_object_folder


def pictures(folder: Path) -> dict[str, np.ndarray]:
    return {path.name: np.asarray(Image.open(path)) for path in sorted(folder.iterdir())}


def test_every_view_is_drawn_at_the_size_asked_for(tmp_path):
    options = RenderOptions(SAMPLE, tmp_path / "out", views=("0,15", "90,-30"), size_px=48)
    assert run(options) == 0
    drawn = pictures(tmp_path / "out")
    assert list(drawn) == ["view_0_15.png", "view_90_-30.png"]
    first, second = drawn.values()
    assert first.shape == second.shape == (48, 48, 3)
    assert not np.array_equal(first, second)
    assert np.array_equal(first[0, 0], [255, 255, 255])  # the background
    assert first.min() < 128  # the object


@pytest.mark.parametrize("channel", ["alpha", "depth"])
def test_channels_are_black_where_nothing_is_and_bright_where_the_object_is(tmp_path, channel):
    run(RenderOptions(SAMPLE, tmp_path, views=("0,15",), size_px=48, channel=channel))
    (picture,) = pictures(tmp_path).values()
    assert picture.shape == (48, 48)
    assert picture[0, 0] == 0
    assert picture.max() > 200


def test_splats_that_cannot_be_drawn_are_counted(tmp_path, capsys):
    splats = read_splats(SAMPLE).splats
    means = splats.means.clone()
    means[:3] = 1e19
    write_splats(tmp_path / "odd.ply", dataclasses.replace(splats, means=means))
    options = RenderOptions(tmp_path / "odd.ply", tmp_path / "out", views=("0,0",), size_px=8)
    assert run(options) == 0
    assert "3 splats not drawn: too large" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"size_px": 0}, "--size-px"),
        ({"fov": 81.0}, "--fov"),
        ({"views": ()}, "--views"),
        ({"views": ("0,200",)}, "--views"),
        ({"views": ("north",)}, "--views"),
        ({"size": 1.0}, "--center, --object-size: expected both"),
        ({"center": "0,0,0"}, "--center, --object-size: expected both"),
        ({"center": "0,0", "size": 1.0}, "--center: expected X,Y,Z"),
        ({"center": "0,0,0", "size": -1.0}, "--object-size"),
        ({"background": "1,1"}, "--background"),
        ({"background": "0,0,255"}, "--background: expected 0 to 1"),
        ({"file": Path("missing.ply")}, "missing.ply"),
    ],
)
def test_bad_options_are_named(tmp_path, change, named):
    options = dataclasses.replace(RenderOptions(SAMPLE, tmp_path / "out"), **change)
    with pytest.raises(UserError, match=named):
        run(options)
    assert not (tmp_path / "out").exists()


def test_an_out_of_memory_error_of_torch_is_told_as_one(capsys):
    def allocate() -> int:
        torch.empty(1 << 50)
        return 0

    assert run_guarded("gscomplete", allocate, "") == 4
    assert "out of memory" in capsys.readouterr().err


def test_a_splat_without_extent_is_drawn(tmp_path):
    one = read_splats(SAMPLE).splats.select(torch.tensor([0]))
    write_splats(tmp_path / "dot.ply", dataclasses.replace(one, scales=torch.zeros(1, 3)))
    options = RenderOptions(tmp_path / "dot.ply", tmp_path / "out", views=("0,0",), size_px=8)
    assert run(options) == 0


def test_floaters_do_not_shrink_the_picture_and_are_told(tmp_path, capsys):
    splats = read_splats(SAMPLE).splats
    means = splats.means.clone()
    means[:5] = torch.tensor([1e4, 0.0, 0.0])
    write_splats(tmp_path / "odd.ply", dataclasses.replace(splats, means=means))
    options = RenderOptions(tmp_path / "odd.ply", tmp_path / "out", views=("0,15",), size_px=48)
    assert run(options) == 0
    assert "5 splats lie outside the frame" in capsys.readouterr().err
    run(RenderOptions(SAMPLE, tmp_path / "sound", views=("0,15",), size_px=48))
    assert "outside" not in capsys.readouterr().err
    (odd,), (sound,) = (pictures(tmp_path / name).values() for name in ("out", "sound"))
    # five splats of 5,302 are missing: a pixel or two may change, the picture does not
    assert np.abs(odd.astype(float) - sound).mean() < 1


def test_the_frame_may_be_given(tmp_path):
    common = {"views": ("0,0",), "size_px": 64, "channel": "alpha"}
    splats = read_splats(SAMPLE).splats
    low, high = splats.bounds()
    x, y, z = ((low + high) / 2).tolist()
    for name, factor in (("near", 1.0), ("far", 3.0)):
        size = factor * float((high - low).max())
        given = {"center": f"{x},{y},{z}", "size": size, **common}
        assert run(RenderOptions(SAMPLE, tmp_path / name, **given)) == 0
    (near,), (far,) = (pictures(tmp_path / name).values() for name in ("near", "far"))
    assert (near > 0).sum() > 5 * (far > 0).sum() > 0


def test_an_object_folder_is_drawn_in_its_own_frame(tmp_path):
    """The recorded frame is that of the complete object, of which the part fills but half."""
    splats = read_splats(SAMPLE).splats
    folder = write_object_folder(tmp_path / "mug", splats, frame=ObjectFrame("Y", (0, 0, 0), 3.0))
    run(RenderOptions(folder, tmp_path / "a", views=("0,15",), size_px=48))
    given = {"up": "Y", "center": "0,0,0", "size": 3.0}
    file = folder / "partial.ply"
    run(RenderOptions(file, tmp_path / "b", views=("0,15",), size_px=48, **given))
    (of_folder,), (of_file,) = pictures(tmp_path / "a").values(), pictures(tmp_path / "b").values()
    assert np.array_equal(of_folder, of_file)
    run(RenderOptions(folder, tmp_path / "c", views=("0,15",), size_px=48, up="Z"))
    (other,) = pictures(tmp_path / "c").values()
    assert not np.array_equal(of_folder, other)


def test_a_folder_of_something_else_is_named(tmp_path):
    with pytest.raises(UserError, match=r"a run folder \(run\.json\) or an object folder"):
        run(RenderOptions(tmp_path, tmp_path / "out"))
