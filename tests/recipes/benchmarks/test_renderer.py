"""The renderer's benchmarks at a small size: what they say of known things is right."""

import json
import time
from pathlib import Path

import numba
import numpy as np
import pytest
import torch
from PIL import Image

from gscomplete.errors import UserError
from gscomplete.render import RenderSettings, render
from recipes.benchmarks.clocks import clock_reader
from recipes.benchmarks.curves.charts import Chart, draw_charts
from recipes.benchmarks.renderer import __main__ as speed
from recipes.benchmarks.renderer import accuracy, peers, work
from recipes.benchmarks.renderer.machine_limits import MachineLimits, measure_limits
from recipes.benchmarks.renderer.scenes import bench_camera, cloud, surface_discs

PEER = """
from gscomplete.render import render
from gscomplete.splats import Splats

NAME = "twin of ours"


def project(splats, cameras):
    return tuple(value * 1 for _, value in splats.fields())


def composite(screen, cameras):
    return render(Splats(*screen), cameras, backend="cpu").color[0] * {scale}
"""


@pytest.fixture(autouse=True)
def threads():
    """Benchmarks set threads; put them back."""
    before = numba.get_num_threads(), torch.get_num_threads()
    yield
    numba.set_num_threads(before[0])
    torch.set_num_threads(before[1])


def test_exponents_of_power_laws_are_found():
    overall, last = speed.exponents([(n, 3.0 * n**1.5) for n in (10, 100, 1000)])
    assert overall == pytest.approx(1.5)
    assert last == pytest.approx(1.5)
    overall, last = speed.exponents([(n, 50.0 + n) for n in (1, 10, 100, 10_000, 100_000)])
    assert overall < 0.8 < last <= 1.0


def test_speed_run_leaves_numbers_and_plot(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    options = speed.Options(
        counts=(50, 200), sizes=(16, 40), degrees=(0, 3), splats=200, size_px=40, repeats=3,
        threads=(1,), clock="cpu", out=tmp_path,
    )  # fmt: skip
    speed.main(options)
    content = json.loads((tmp_path / "renderer.json").read_text())
    assert content["bit_identical_over_threads"] is True
    rows = content["sweeps"]["splats"]
    assert [row["splats"] for row in rows] == [50, 200]
    assert all(0 < row["fastest_ms"] <= row["total_ms"] for row in rows)
    assert {line["over"] for line in content["growth"]} == {"splats", "pixels"}
    with Image.open(tmp_path / "renderer.png") as picture:
        assert picture.width > 1000
    assert "of peak" in capsys.readouterr().out


def test_more_threads_than_there_are_is_refused():
    many = numba.config.NUMBA_NUM_THREADS + 1
    with pytest.raises(UserError, match="--threads"):
        speed.main(speed.Options(threads=(many,)))
    with pytest.raises(UserError, match="--threads"):
        peers.main(peers.Options(threads=many))


def test_stages_cover_the_pass_and_count_what_is_drawn():
    numba.set_num_threads(1)
    limits = MachineLimits(1, copy_gb_s=10.0, gflop_s=100.0)
    splats = surface_discs(None, 300)
    camera = bench_camera(32)
    stages = {s.name: s for s in work.measure_stages(splats, camera, limits, 3)}
    drawn, back = stages["composite"], stages["composite_backward"]
    assert drawn.gflop
    assert back.gflop
    assert back.gflop / drawn.gflop == pytest.approx(64 / 38)
    pixels = drawn.gflop * 1e9 / work.FORWARD_OPERATIONS
    assert len(splats) < pixels < len(splats) * 32 * 32
    assert drawn.arithmetic_share == pytest.approx(drawn.gflop / (drawn.ms * 1e-3) / 100.0)
    assert drawn.megabytes
    assert drawn.memory_share == pytest.approx(drawn.megabytes / drawn.ms / 10.0)
    assert work.OTHER in stages
    assert {"project", "project_backward", "_sort_parts"} <= stages.keys()
    # the recorder is gone: the same picture, by the compiled kernels
    assert render(splats, camera, backend="cpu").alpha.max() > 0.9


def test_processor_time_is_for_one_thread():
    assert clock_reader("wall", 2) is time.perf_counter
    assert clock_reader("cpu", 1) is time.process_time
    with pytest.raises(UserError, match="--threads 1"):
        clock_reader("cpu", 2)


def test_limits_are_positive_and_restore_threads():
    limits = measure_limits(1, repeats=1)
    assert limits.copy_gb_s > 0.1
    assert limits.gflop_s > 0.1


@pytest.mark.parametrize("splats", [surface_discs(None, 150, 1), cloud(150, 1)])
def test_errors_fall_with_the_cut_off_and_defaults_keep_bounds(splats):
    torch.manual_seed(0)
    settings = [RenderSettings(), RenderSettings(alpha_min=1e-5, transmittance_min=0.0)]
    default, finest = accuracy.measure_errors(splats, bench_camera(24), settings)
    assert default[0].color_max < 1e-4
    assert default[0].worst_gradient < accuracy.GRADIENT
    assert default[1].color_max > 1e-3  # what the definition leaves out shows
    assert finest[1].color_max < 1e-3
    assert finest[1].worst_gradient < default[1].worst_gradient
    rows = [
        accuracy.Row("s", s.alpha_min, s.transmittance_min, True, ms, ms, *errors)
        for s, ms, errors in zip(settings, (1.0, 2.0), (default, finest), strict=True)
    ]
    assert all(accuracy.on_front(row, rows) for row in rows)
    assert accuracy.failures(rows) == []
    slow = accuracy.Row("s", 1e-3, 0.0, True, 3.0, 3.0, *default)
    assert not accuracy.on_front(slow, [*rows[1:], slow])


def test_missed_bounds_are_named():
    bad = accuracy.Errors(1.0, 1e-9, {"means": float("nan"), "sh": 0.5})
    default = RenderSettings()
    cut = default.alpha_min, default.transmittance_min
    missed = accuracy.failures([accuracy.Row("s", *cut, True, 1.0, 1.0, bad, bad)])
    assert [m.split(" ")[1] for m in missed] == ["mean", "gradient", "gradient"]


def test_accuracy_run_leaves_numbers_and_plot(tmp_path: Path):
    options = accuracy.Options(
        scenes=("cloud",), splats=60, size_px=16, sh_degree=0, time_splats=100, time_size_px=16,
        transmittance_min=(0.0, 1e-5), repeats=1, threads=1, clock="cpu", out=tmp_path,
    )  # fmt: skip
    accuracy.main(options)
    content = json.loads((tmp_path / "renderer_accuracy.json").read_text())
    assert len(content["rows"]) == 9
    assert any(row["pareto"] for row in content["rows"])
    assert content["default_misses"] == []
    assert (tmp_path / "renderer_accuracy.png").stat().st_size > 1000


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_a_peer_is_timed_and_compared(tmp_path: Path, scale: float):
    (tmp_path / "peer.py").write_text(PEER.format(scale=scale))
    peer = peers.load_peer(tmp_path / "peer.py")
    torch.manual_seed(0)
    rows = peers.compare([peer], cloud(80), bench_camera(24), 3)
    found, ours = rows["twin of ours"], rows["ours"]
    assert ours["ratio"] == ours["fastest_ratio"] == 1.0
    assert found["ratio"] == pytest.approx(found["total_ms"] / ours["total_ms"])
    assert min(found[f"{part}_ms"] for part in ("project", "composite", "project_backward")) > 0
    for value in found["distance"]["gradient_relative"].values():
        assert value == pytest.approx(1 - scale, abs=1e-6)
    assert (found["distance"]["color_max"] > 0.1) == (scale != 1.0)


def test_a_file_that_is_no_peer_is_refused(tmp_path: Path):
    with pytest.raises(UserError, match="found none"):
        peers.load_peer(tmp_path / "absent.py")
    (tmp_path / "half.py").write_text("NAME = 'half'\n")
    with pytest.raises(UserError, match=r"missing \['project', 'composite'\]"):
        peers.load_peer(tmp_path / "half.py")
    (tmp_path / "text.txt").write_text("")
    with pytest.raises(UserError, match="Python file"):
        peers.load_peer(tmp_path / "text.txt")


def test_peers_run_writes_json(tmp_path: Path):
    (tmp_path / "peer.py").write_text(PEER.format(scale=1.0))
    peers.main(
        peers.Options(
            peer=(tmp_path / "peer.py",),
            splats=(40,),
            sizes=(16,),
            threads=1,
            repeats=2,
            json=tmp_path / "peers.json",
        )
    )
    (point,) = json.loads((tmp_path / "peers.json").read_text())["points"]
    assert set(point["renderers"]) == {"ours", "twin of ours"}


@pytest.mark.parametrize(("log_x", "log_y"), [(True, True), (False, True), (False, False)])
def test_charts_put_points_where_they_belong(log_x: bool, log_y: bool):
    low, high = (1.0, 1e-6), (1000.0, 1e2)
    chart = Chart("t", "x", "y", {"rise": [low, high]}, log_x, log_y, limits={"l": 1.0})
    picture = np.asarray(draw_charts([chart, chart], columns=2, size=(400, 200)))
    assert picture.shape == (200, 800, 3)
    ys, xs = np.nonzero((picture[:, :250] == (0x1F, 0x5F, 0xA8)).all(axis=2))
    assert xs.max() - xs.min() > 150
    assert ys[xs.argmax()] < ys[xs.argmin()] - 80


def test_charts_stand_degenerate_numbers():
    curves = {"one": [(5.0, 0.0)], "bad": [(1.0, float("nan"))], "none": []}
    for log in (True, False):
        keep = {name: [p for p in c if p[1] == p[1]] for name, c in curves.items()}
        assert draw_charts([Chart("t", "x", "y", keep, log, log)], 1).width > 0
