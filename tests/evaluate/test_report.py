"""Reports hold the paper's metrics, survive JSON, and admit what is missing."""

import dataclasses
import importlib
import json
import types
from typing import Any

import numpy as np
import pytest
import torch

from gscomplete.evaluate import (
    EvaluationReport,
    EvaluationSettings,
    Unavailable,
    evaluate,
    perceptual,
    preservation,
)
from gscomplete.evaluate.perceptual import clip_similarity, lpips_error
from gscomplete.evaluate.rows import row_of
from gscomplete.render import render
from gscomplete.splats import Splats, concatenate
from gscomplete.util import jsonio
from gscomplete.views import ViewDistribution
from tests.builders.objects import round_splats

VIEWS = ViewDistribution(0.0, 0.0)
SETTINGS = EvaluationSettings(views=4, truth_views=4, size_px=32)


def blob(x: float) -> Splats:
    generator = torch.Generator().manual_seed(0)
    means = 0.1 * torch.randn(80, 3, generator=generator) + torch.tensor([x, 0.0, 0.0])
    return round_splats(means, scale=0.05, color=torch.rand(80, 3, generator=generator))


@pytest.fixture(autouse=True)
def _no_optional_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    real = importlib.import_module

    def without(name: str, package: str | None = None) -> Any:
        if name in ("lpips", "transformers", "huggingface_hub.constants"):
            raise ImportError(name)
        return real(name, package)

    monkeypatch.setattr(importlib, "import_module", without)


def test_report_round_trips() -> None:
    partial, complete = blob(0.2), concatenate([blob(0.2), blob(-0.2)])
    report = evaluate(complete, partial, VIEWS, truth=complete, settings=SETTINGS)
    assert report.input_view.views == 1
    assert report.all_views.views == 4
    assert report.truth is not None
    assert report.truth.hidden_iou == 1.0
    back = jsonio.from_json(EvaluationReport, json.loads(jsonio.dumps(report)), "run.json")
    assert back == report


def test_unknown_truth_is_left_out() -> None:
    report = evaluate(blob(0.0), blob(0.0), VIEWS, settings=SETTINGS)
    assert report.truth is None
    assert report.all_views.color == 0.0


def test_missing_packages_are_named() -> None:
    camera = VIEWS.input_camera(16)
    lpips = lpips_error(blob(0.0), blob(0.0), camera)
    clip = clip_similarity(blob(0.0), blob(0.0), camera, VIEWS.ring(4, 16))
    assert isinstance(lpips, Unavailable)
    assert isinstance(clip, Unavailable)
    assert "lpips" in lpips.reason
    assert "transformers" in clip.reason


def test_missing_weights_are_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> None:
    def refuse(model: str, local_files_only: bool) -> None:
        assert local_files_only  # evaluation must never download
        raise OSError("no such model")

    loader = types.SimpleNamespace(from_pretrained=refuse)
    fake = types.SimpleNamespace(
        CLIPModel=loader, CLIPImageProcessor=loader, HF_HUB_CACHE=str(tmp_path)
    )
    imported = []
    monkeypatch.setattr(importlib, "import_module", lambda name: imported.append(name) or fake)
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    camera = VIEWS.input_camera(16)
    lpips = lpips_error(blob(0.0), blob(0.0), camera)
    clip = clip_similarity(blob(0.0), blob(0.0), camera, VIEWS.ring(4, 16))
    assert isinstance(lpips, Unavailable)
    assert "AlexNet weights" in lpips.reason
    assert isinstance(clip, Unavailable)
    assert "CLIP weights" in clip.reason
    assert "transformers" not in imported  # it takes a second to load
    (tmp_path / "models--openai--clip-vit-large-patch14").mkdir()
    assert clip_similarity(blob(0.0), blob(0.0), camera, VIEWS.ring(4, 16)) == clip
    assert "transformers" in imported


def test_clip_of_the_installed_transformers(monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> None:
    """A tiny model with random weights: what stands still keeps its embedding."""
    monkeypatch.undo()  # the packages are there again
    transformers = pytest.importorskip("transformers")
    size = {"hidden_size": 16, "intermediate_size": 16, "num_attention_heads": 2}
    layers = size | {"num_hidden_layers": 1}
    torch.manual_seed(0)
    config = transformers.CLIPConfig(
        text_config=layers | {"vocab_size": 9, "bos_token_id": 0, "eos_token_id": 1},
        vision_config=layers | {"image_size": 32, "patch_size": 16},
        projection_dim=8,
    )
    transformers.CLIPModel(config).save_pretrained(tmp_path)
    transformers.CLIPImageProcessor(size=32, crop_size=32).save_pretrained(tmp_path)
    camera, here = VIEWS.input_camera(32), blob(0.0)
    sides = VIEWS.cameras(VIEWS.low_discrepancy(1), 32)  # c itself
    assert clip_similarity(here, here, camera, sides, str(tmp_path)) == pytest.approx(100, abs=1e-3)
    other = clip_similarity(blob(0.3), here, camera, sides, str(tmp_path))
    assert isinstance(other, float)
    assert other < 100


def test_clip_is_the_mean_cosine_with_four_sides(monkeypatch: pytest.MonkeyPatch) -> None:
    """With mean colours as embeddings, S_CLIP is computed a second time from the pictures."""
    asked: list[np.ndarray] = []

    def process(images: list[np.ndarray], return_tensors: str) -> dict[str, torch.Tensor]:
        asked.extend(images)
        means = [torch.from_numpy(image.astype(np.float64)).mean(dim=(0, 1)) for image in images]
        return {"means": torch.stack(means) - 230.0}

    network = types.SimpleNamespace(get_image_features=lambda means: means)
    fake = types.SimpleNamespace(
        CLIPModel=types.SimpleNamespace(from_pretrained=lambda *a, **k: network),
        CLIPImageProcessor=types.SimpleNamespace(from_pretrained=lambda *a, **k: process),
    )
    monkeypatch.setattr(importlib, "import_module", lambda name: fake)
    monkeypatch.setattr(perceptual, "_may_be_here", lambda model: True)
    partial, complete = blob(0.2), concatenate([blob(0.2), blob(-0.2)])
    sides = VIEWS.ring(4, 24)
    found = clip_similarity(complete, partial, VIEWS.input_camera(24), sides)
    cosines = []
    white = torch.ones(3)
    first = render(partial, VIEWS.input_camera(24), white).color[0]
    for offset_deg in (0.0, 90.0, 180.0, 270.0):
        around = dataclasses.replace(VIEWS, azimuth_deg=VIEWS.azimuth_deg + offset_deg)
        picture = render(complete, around.input_camera(24), white).color[0]
        u, v = (
            (255 * p.clamp(0, 1)).to(torch.uint8).double().mean(dim=(0, 1)) - 230
            for p in (first, picture)
        )
        cosines.append(float(u @ v / u.norm() / v.norm()))
    assert len(asked) == 5
    assert found == pytest.approx(100 * float(np.mean(cosines)), rel=1e-6)


def test_the_order_of_no_splats_matters() -> None:
    """Of P, O and the truth; to the rounding of sums and of depths that float32 cannot tell."""
    partial, truth = blob(0.2), concatenate([blob(0.2), blob(-0.2)])
    completed = concatenate([blob(0.2), blob(-0.1)])
    generator = torch.Generator().manual_seed(5)
    shuffled = [
        splats.select(torch.randperm(len(splats), generator=generator))
        for splats in (completed, partial, truth)
    ]
    rows = [
        row_of(evaluate(o, p, VIEWS, truth=t, settings=SETTINGS), "m", "o", None).values
        for o, p, t in ((completed, partial, truth), shuffled)
    ]
    for name, value in rows[0].items():
        expected = value if value is None else pytest.approx(value, rel=1e-4, abs=1e-7)
        assert rows[1][name] == expected, name


def test_lpips_map_is_weighted_by_the_mask(monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> None:
    """With squared differences in the network's place, E_LPIPS is four times E_color."""

    def network(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
        return ((a - b) ** 2).mean(dim=1, keepdim=True)

    fake = types.SimpleNamespace(LPIPS=lambda **options: network)
    monkeypatch.setattr(importlib, "import_module", lambda name: fake)
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    (tmp_path / "checkpoints").mkdir()
    (tmp_path / "checkpoints" / "alexnet-owt-7be5be79.pth").touch()
    partial = blob(0.0)
    other = dataclasses.replace(partial, sh=1.2 * partial.sh)
    camera = VIEWS.input_camera(32)
    expected = 4 * preservation(other, partial, camera).color
    assert lpips_error(other, partial, camera) == pytest.approx(expected, rel=1e-4)
