"""A run that goes on is followed until it has finished."""

import json
import threading

import torch

from gscomplete.completion.settings import LearningRates
from gscomplete.fitting.checkpoint import save_checkpoint
from gscomplete.fitting.parameters import SplatParameters
from gscomplete.viewer.live import follow, newest
from gscomplete.views import ObjectFrame, ViewDistribution
from tests.builders.objects import random_splats


def save(folder, step, count):
    state = SplatParameters(random_splats(count), LearningRates()).state()
    save_checkpoint(folder / "checkpoints", {**state, "step": torch.tensor(step)})


def test_checkpoints_are_told_once_each_and_then_the_end(tmp_path):
    record = {
        "status": "running",
        "input": {"splats": 3},
        "identity": {
            "frame": ObjectFrame("Z", (0.0, 0.0, 0.0), 1.0).to_json(),
            "views": ViewDistribution(0.0, 0.0).to_json(),
        },
    }
    (tmp_path / "run.json").write_text(json.dumps(record))
    assert newest(tmp_path) is None
    save(tmp_path, 10, 4)
    told, results = [], []

    def hear(progress):
        told.append((progress.step, len(progress.splats)))
        if progress.step == 10:
            save(tmp_path, 20, 5)
        else:
            (tmp_path / "completed.ply").touch()

    def see(is_finished):
        results.append(is_finished)
        (tmp_path / "run.json").write_text(json.dumps(record | {"status": "finished"}))

    follow(tmp_path, hear, see, threading.Event(), poll_s=0.02)
    assert told == [(10, 4), (20, 5)]
    assert results == [False, True]


def test_following_stops_when_told_to(tmp_path):
    stop = threading.Event()
    stop.set()
    follow(tmp_path, lambda progress: None, lambda is_finished: None, stop)
