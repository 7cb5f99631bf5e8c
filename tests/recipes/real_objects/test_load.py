"""The table of real objects is sound, and its objects load with real parts cut out."""

import csv
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gscomplete.errors import UserError
from gscomplete.views import ObjectFrame, up_rotation
from recipes.real_objects.catalogue import ENTRIES, BoxCut, Entry, PlaneCut, ScanCut
from recipes.real_objects.load import (
    cut_object,
    find,
    load_real_object,
    manifest_captions,
    names,
    rotation_from_table_points,
)
from tests.builders.objects import box

DATA = Path(__file__).resolve().parents[3] / "../shared/data"


def need_data() -> None:
    if not (DATA / "MANIFEST.tsv").is_file():
        pytest.skip("real data are not here (../shared/data)")


def test_table_is_wide_enough() -> None:
    assert len(set(names())) == len(ENTRIES) >= 24
    meshes = [entry for entry in ENTRIES if entry.source == "mesh"]
    assert len(meshes) >= 18
    assert sum(entry.source == "scan" for entry in ENTRIES) >= 8
    assert any(entry.source == "splats" for entry in ENTRIES)


def test_table_spans_ten_categories_and_every_file_exists() -> None:
    need_data()
    with (DATA / "MANIFEST.tsv").open() as file:
        rows = csv.DictReader(file, delimiter="\t", quoting=csv.QUOTE_NONE)
        categories = {row["path"]: row["category"] for row in rows}
    captions = manifest_captions(DATA)
    assert len({categories[entry.path] for entry in ENTRIES if entry.source == "mesh"}) >= 10
    for entry in ENTRIES:
        assert (DATA / entry.path).is_file(), entry.path
        assert entry.prompt or captions[entry.path]


def test_unknown_names_and_missing_data_are_user_errors(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="nonsense"):
        find("nonsense")
    with pytest.raises(UserError, match="no such file"):
        load_real_object("blue_mug", tmp_path)
    with pytest.raises(UserError, match=r"MANIFEST\.tsv"):
        manifest_captions(tmp_path)


@pytest.mark.parametrize("up", ["X", "Y", "Z", "-X", "-Y", "-Z"])
def test_cuts_are_made_in_the_object_frame(up: str) -> None:
    splats = box(up)
    frame = ObjectFrame.about(splats, up)  # type: ignore[arg-type]
    spacing = 4.0 / 4000  # of places along x; each outermost one is a few of them inside
    assert frame.size_file == pytest.approx(4.0, abs=8 * spacing)
    along = (splats.means - 50.0) @ up_rotation(up).float().T  # type: ignore[arg-type]

    def kept(cut: PlaneCut | BoxCut | ScanCut) -> torch.Tensor:
        entry = Entry("x", "x", "mesh", up, cut)  # type: ignore[arg-type]
        return along[cut_object(splats, entry).mask]

    half = kept(PlaneCut(0.0))
    assert half[:, 0].max() == pytest.approx(2.0, abs=4 * spacing)
    assert half[:, 0].min() == pytest.approx(0.0, abs=4 * spacing)
    most = kept(PlaneCut(90.0, offset=0.125))  # half a unit beyond the middle
    assert most[:, 1].max() == pytest.approx(1.5, abs=4 * spacing)
    corner = kept(BoxCut((-0.5, -0.5, -0.5), (0.0, 0.5, 0.5)))
    assert corner[:, 0].max() == pytest.approx(2.0, abs=4 * spacing)
    seen = kept(ScanCut((0.0,), 0.0))
    assert seen[:, 0].mean() > 2.5  # the +x side was scanned


@given(st.floats(-60, 60), st.floats(-40, 40), st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_tables_become_level(pitch_deg: float, roll_deg: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    pitch, roll = np.deg2rad([90 + pitch_deg * 0.8, roll_deg])
    normal = np.array([np.sin(roll), -np.cos(roll) * np.sin(pitch), np.cos(roll) * np.cos(pitch)])
    first = np.cross(normal, [1.0, 0.3, 0.2])
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    table = -0.8 * normal + rng.uniform(-1, 1, (3000, 2)) @ np.stack([first, second])
    table += rng.normal(0, 0.003, table.shape)
    table[:60] += 0.4 * normal  # something stands on it
    rotation = rotation_from_table_points(table)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert rotation[2] @ normal > 0.9999


@pytest.mark.parametrize("name", ["orange_table", "duck", "shoe_rack", "scan_can"])
def test_real_objects_load(name: str) -> None:
    need_data()
    item = load_real_object(name, DATA)
    assert torch.isfinite(item.partial.means).all()
    assert float(item.partial.base_colors.std()) > 0.02
    if item.complete is None:
        assert len(item.partial) > 1000
        return
    assert 0.1 < len(item.partial) / len(item.complete) < 0.6
    assert item.true_frame is not None
    again = load_real_object(name, DATA)
    for (_, a), (_, b) in zip(item.partial.fields(), again.partial.fields(), strict=True):
        assert torch.equal(a, b)
