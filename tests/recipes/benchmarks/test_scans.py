"""The benchmarks of scans and scan cuts run on a real object each, and find what is known of it."""

from pathlib import Path

import pytest

from gscomplete.errors import UserError
from gscomplete.util.optional import import_open3d
from recipes.benchmarks import scan_cuts, scan_objects
from splatcomplete_data.scan.read import read_scan

DATA = Path(__file__).resolve().parents[3] / "../shared/data"


@pytest.fixture(autouse=True)
def _needs_data_and_open3d() -> None:
    if not DATA.is_dir():
        pytest.skip("real data are not here (../shared/data)")
    try:
        import_open3d("the test")
    except UserError as error:
        pytest.skip(str(error))


def test_a_labelled_object_is_cut_out_and_levelled():
    scan = read_scan(DATA / scan_objects.FOLDER / "learn_learn0.pcd")
    for row in scan_objects.measured("learn0", scan, 2):
        assert row.precision > 0.95
        assert row.recall > 0.95
        assert row.up_deg is not None
        assert row.up_deg < 10


def test_a_scan_cut_keeps_what_rays_reach():
    path = "mesh/pytorch3d/cow_mesh/cow.obj"
    kept = scan_cuts.measure(path, 1, scan_cuts.Options(DATA, count=20_000))
    assert kept.visible > 0.98
    assert kept.hidden < 0.02
