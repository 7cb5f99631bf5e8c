"""The comparison tells what a format's coding explains from what it does not."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from gscomplete.splats import Splats
from recipes.benchmarks.formats.round_trips import Report, by_gsply, random_splats


def report_of(wanted: Splats, found: Splats) -> Report:
    report = Report()
    report.compare("here", "spz", wanted, found)
    return report


def test_order_and_half_turns_about_a_splats_axes_are_no_errors() -> None:
    splats = random_splats(200, 1)
    w, x, y, z = splats.quaternions.unbind(dim=1)
    turned = replace(splats, quaternions=torch.stack([-x, w, z, -y], dim=1))  # after i
    assert report_of(splats, turned.select(torch.randperm(200))).misses == 0


@pytest.mark.parametrize("name", ["means", "quaternions", "scales", "opacities", "sh"])
def test_what_lies_beyond_a_limit_is_counted(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    splats = random_splats(200, 0)
    value = getattr(splats, name).clone()
    value[7] = 0.8 * value[7] + 0.1
    assert report_of(splats, replace(splats, **{name: value})).misses == 1
    assert "BEYOND" in capsys.readouterr().out
    assert report_of(splats, splats.select(torch.arange(199))).misses == 1


def test_gsply_reads_what_is_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("gsply")
    report = Report()
    by_gsply(report, random_splats(600, 2), tmp_path)
    assert report.misses == 0
    assert capsys.readouterr().out.count("within") == 2
