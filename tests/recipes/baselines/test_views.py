"""Views that other systems are given, and painted ones that come back."""

import json

import numpy as np
import pytest
import torch
from PIL import Image

from gscomplete.errors import UserError
from gscomplete.folders import read_object_folder
from gscomplete.splats import Similarity, read_splats
from recipes.baselines.views import OFFSETS_DEG, export, paint, sdxl_painter, take_back
from tests.builders.folders import write_object_folder
from tests.builders.objects import round_splats


@pytest.fixture
def known(tmp_path):
    points = np.random.default_rng(0).normal(size=(400, 3))
    points /= 3 * np.linalg.norm(points, axis=1, keepdims=True)
    splats = round_splats(points + np.array([0.1, 0, 0]), scale=0.03)
    return read_object_folder(write_object_folder(tmp_path / "ball", splats))


def test_cameras_lead_from_the_file_to_the_pictures(known, tmp_path):
    content = export(known, tmp_path / "views", 64)
    assert json.loads((tmp_path / "views/views.json").read_text()) == content
    assert [row["azimuth_offset_deg"] for row in content["views"]] == list(OFFSETS_DEG)
    points = read_splats(known.partial).splats.means
    for row in content["views"]:
        in_object = Similarity.from_json(row["object_from_file"]).apply(points).double()
        pose = torch.tensor(row["camera_from_object"], dtype=torch.float64)
        local = in_object @ pose[:3, :3].T + pose[:3, 3]
        place = local[:, :2] / local[:, 2:] * torch.tensor(row["focal_px"])
        column, line = (place + torch.tensor(row["center_px"])).floor().long().T
        picture = np.array(Image.open(tmp_path / "views" / row["image"]))
        assert picture.shape == (64, 64, 4)
        assert (picture[line, column, 3] > 128).mean() > 0.95
        assert (picture[[0, -1], :, 3] == 0).all()
        mask = np.array(Image.open(tmp_path / "views" / row["mask"]))
        assert np.array_equal(mask == 255, picture[:, :, 3] < 127.5)


def test_painted_pictures_keep_ps_pixels(known, tmp_path):
    folder = tmp_path / "views"
    export(known, folder, 64)
    asked = []

    def painter(image, mask, prompt):
        asked.append((image.getpixel((0, 0)), mask.getpixel((0, 0)), prompt))
        return Image.new("RGB", (128, 128), (0, 0, 255))

    Image.new("RGB", (32, 32), (0, 255, 0)).save(folder / "inpainted_000.png")
    paint(folder, known.prompt, painter)
    assert asked == [((255, 255, 255), 255, known.prompt)] * 2  # the first had come back
    assert [path.name for path in take_back(folder)] == [
        "given_000.png", "given_090.png", "given_270.png",
    ]  # fmt: skip
    view = np.array(Image.open(folder / "view_090.png"))
    given = np.array(Image.open(folder / "given_090.png"))
    solid = view[:, :, 3] == 255
    assert solid.any()
    assert np.array_equal(given[solid], view[solid])
    assert (given[view[:, :, 3] == 0] == (0, 0, 255, 255)).all()


def test_another_shape_and_missing_weights_are_refused(known, tmp_path):
    folder = tmp_path / "views"
    export(known, folder, 64)
    Image.new("RGB", (64, 32)).save(folder / "inpainted_270.png")
    with pytest.raises(UserError, match="expected a picture of 64 x 64 or its shape, found 64 x 3"):
        take_back(folder)
    with pytest.raises(UserError, match="--paint: unavailable"):
        sdxl_painter(str(tmp_path / "nowhere"), 0)
