import dataclasses
import json

import numpy as np
import pytest

from gscomplete.errors import UserError
from gscomplete.priors.embedded.text import Tokenizer
from recipes.train_embedded_prior.config import ShapeDataConfig
from recipes.train_embedded_prior.data import source
from recipes.train_embedded_prior.data.findings import read_findings
from recipes.train_embedded_prior.data.mesh_source import MixedSource
from recipes.train_embedded_prior.data.shape_dataset import TEXT_LENGTH, ShapeSetMaker
from recipes.train_embedded_prior.export import TrainedRun
from recipes.train_embedded_prior.gpu import make_findings, train
from recipes.train_embedded_prior.gpu.set_pool import ORIENTATIONS
from recipes.train_embedded_prior.gpu.train import Options
from tests.builders.mesh_pack import write_pack
from tests.builders.training import tiny_shape_run


def test_a_run_begins_with_the_parts_of_which_something_is_known(tmp_path, monkeypatch):
    """End to end on the CPU: the loop asks nothing of a GPU but its speed."""
    monkeypatch.setattr(source, "_CAPTIONS_READ", 10)  # a thousand objects take 10 s
    pack, known = write_pack(tmp_path / "pack"), tmp_path / "findings.npy"
    data = ShapeDataConfig(mesh_share=1.0)
    maker = ShapeSetMaker(MixedSource(pack, 1.0), data, Tokenizer((), TEXT_LENGTH), 3)
    np.save(known, np.stack([maker.findings(2).stored(2)]))
    make_findings.main(
        make_findings.Options(pack, known, first=2, last=4, seed=3, mesh_share=1.0, jobs=1)
    )
    assert sorted(read_findings([known])) == [2, 3]  # the first is kept, the other added
    before = known.stat().st_mtime_ns
    make_findings.main(make_findings.Options(pack, known, first=2, last=4))
    assert known.stat().st_mtime_ns == before  # nothing is left to make

    model = tiny_shape_run(tmp_path).model
    run = tiny_shape_run(
        tmp_path / "run",
        minutes=0.01,
        steps=None,
        seed=3,
        meshes=pack,
        workers=1,
        batch_sets=ORIENTATIONS,
        data=data,
        model=dataclasses.replace(model, vocabulary_size=1200),
    )
    np.save(tmp_path / "held_out.npy", np.stack(maker.variants(2, 1, read_findings([known])[2])))
    options = Options(
        run,
        (known,),
        variants=2,
        first_sets=4,
        pool_sets=8,
        held_out=tmp_path / "held_out.npy",
        compiled=False,
    )
    train.main(options)
    trained = TrainedRun.load(tmp_path / "run")
    assert trained.state.step > 0
    assert trained.record().sets >= 4
    lines = [json.loads(x) for x in (tmp_path / "run/log.jsonl").read_text().splitlines()]
    assert 0.0 <= lines[-1]["held_out_iou"] <= 1.0
    assert lines[-1]["sets"] >= 4


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({}, "run.minutes: expected a length in minutes, found steps"),
        ({"minutes": 1.0, "steps": None}, "run.workers: expected 1 or more, found 0"),
        ({"minutes": 1.0, "steps": None, "workers": 1}, "batch-sets: expected a multiple of 8"),
    ],
)
def test_what_it_cannot_do_is_refused(tmp_path, changes, reason):
    with pytest.raises(UserError, match=reason):
        train.main(Options(tiny_shape_run(tmp_path / "run", **changes)))
    assert not (tmp_path / "run").exists()
