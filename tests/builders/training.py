"""Objects that cost nothing to make, and a training run that fits a test."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from gscomplete.shape.network import ShapeModelConfig
from recipes.train_embedded_prior.config import DataConfig, ShapeTrainConfig, TrainConfig
from recipes.train_embedded_prior.data.dataset import TrainingObject
from tests.builders.objects import round_splats
from tests.builders.tiny_denoiser import TINY

WORDS = ("ball", "blue", "red")
DATA = DataConfig(render_px=32)


def stub_source(seed: int, index: int) -> TrainingObject:
    rng = np.random.default_rng((seed, index, 9))
    points = rng.normal(size=(200, 3))
    points = torch.from_numpy(points / np.linalg.norm(points, axis=1, keepdims=True) / 2).float()
    red = rng.random() < 0.5
    colors = torch.tensor([[0.9, 0.1, 0.1] if red else [0.1, 0.1, 0.9]]).expand(200, 3)
    splats = round_splats(points, scale=0.04, opacity=0.95, color=colors)
    side = float(rng.uniform(-0.2, 0.1))
    caption = f"a {'red' if red else 'blue'} ball"
    kept = splats.select(points[:, 0] > side)
    return TrainingObject(splats, caption, lambda disturb, slight: splats if slight else kept)


_SHORT: dict[str, object] = {
    "minutes": None,
    "steps": 4,
    "warmup_steps": 2,
    "replicas": 1,
    "workers": 0,
    "evaluation_sets": 0,
    "shard_sets": 2,
    "precision": "float32",
}


def tiny_run(out: Path, **changes: object) -> TrainConfig:
    options = _SHORT | {"batch_sets": 2, "data": DATA, "model": TINY}
    return TrainConfig(out=out, **(options | changes))  # type: ignore[arg-type]


def tiny_shape_run(out: Path, **changes: object) -> ShapeTrainConfig:
    model = ShapeModelConfig(2 + len(WORDS), widths=(8, 8, 16), blocks=(1, 1, 1), embedding=8)
    options = _SHORT | {"batch_sets": 3, "fresh_sets": 2, "model": model}
    return ShapeTrainConfig(out=out, **(options | changes))  # type: ignore[arg-type]
