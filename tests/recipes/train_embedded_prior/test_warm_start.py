import dataclasses

import pytest
import torch

from gscomplete.errors import UserError
from gscomplete.priors.embedded.text import FIRST_WORD_TOKEN
from gscomplete.shape.network import ShapeModelConfig
from gscomplete.shape.symmetry import COPIES, SOURCES
from gscomplete.shape.voxels import CELLS, COARSE_CELLS
from recipes.train_embedded_prior.export import TrainedRun, export
from recipes.train_embedded_prior.shape_task import ShapeTask
from recipes.train_embedded_prior.state import TrainState, open_run
from recipes.train_embedded_prior.train import train
from recipes.train_embedded_prior.views_task import ViewsTask
from recipes.train_embedded_prior.warm_start import fill, start_weights
from tests.builders.training import WORDS, stub_source, tiny_run, tiny_shape_run

ROOMY = ShapeModelConfig(vocabulary_size=9, widths=(8, 8, 16), blocks=(1, 1, 1), embedding=8)


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """Exported weights of both networks, of seed 3."""
    folder = tmp_path_factory.mktemp("weights")
    runs = []
    for name, task, config in (
        ("views", ViewsTask, tiny_run(folder / "views", seed=3)),
        ("shape", ShapeTask, tiny_shape_run(folder / "shape", seed=3)),
    ):
        made = task(config, stub_source, WORDS)
        open_run(config, WORDS)
        TrainState.start(config, made.make_model).save(config.out)
        runs.append(TrainedRun.load(folder / name))
    views = runs[0]
    framing = views.config.data.views(views.config.model.resolution_px)
    parts = [run.exportable().with_words(WORDS) for run in runs]
    export(parts[0], framing, parts[1], folder / "out", "float32")
    return folder / "out"


@pytest.mark.parametrize("kind", ["views", "shape"])
def test_runs_of_both_networks_start_from_the_weights(kind, tmp_path, weights):
    run, task = (tiny_run, ViewsTask) if kind == "views" else (tiny_shape_run, ShapeTask)
    config = run(tmp_path, start_from=weights)
    make_model = task(config, stub_source, WORDS).make_model
    state = TrainState.start(config, make_model)
    plain = TrainState.start(dataclasses.replace(config, start_from=None), make_model)
    changed = 0
    for name, value in start_weights(config).state.items():
        for model in (state.model, state.ema):
            assert torch.equal(model.state_dict()[name][: len(value)], value), name
        changed += not torch.equal(plain.model.state_dict()[name][: len(value)], value)
    assert changed > 3


def test_new_words_follow_those_of_the_weights(tmp_path, weights):
    config = tiny_shape_run(tmp_path, start_from=weights, model=ROOMY)
    words = open_run(config, ("apple", *reversed(WORDS)))
    assert words == (*WORDS, "apple")
    state = TrainState.start(config, ShapeTask(config, stub_source, words).make_model)
    known = FIRST_WORD_TOKEN + len(WORDS)
    rows = state.model.words.weight.detach()
    assert torch.equal(rows[:known], start_weights(config).state["words.weight"])
    assert (rows[known:] != 0).any()


def test_a_resumed_run_goes_on_from_its_checkpoint(tmp_path, weights):
    """It neither starts anew nor forgets where it came from, nor needs what it started from."""
    config = tiny_shape_run(tmp_path, start_from=weights, steps=2)
    train(ShapeTask(config, stub_source, open_run(config, WORDS)))
    again = dataclasses.replace(config, resume=True, steps=3)
    words = open_run(again, WORDS)
    assert train(ShapeTask(again, stub_source, words)).step == 3
    (tmp_path / "run.json").write_text(
        (tmp_path / "run.json").read_text().replace(str(weights), str(tmp_path / "gone"))
    )
    record = TrainedRun.load(tmp_path).record()
    assert (record.steps, record.sets) == (3, 6)


def test_weights_of_other_sizes_are_refused(weights, tmp_path):
    wide = dataclasses.replace(ROOMY, widths=(8, 16, 16))
    config = tiny_shape_run(tmp_path, start_from=weights, model=wide)
    with pytest.raises(UserError, match=r"expected \[.*\] as in the weights, the model to train"):
        TrainState.start(config, ShapeTask(config, stub_source, WORDS).make_model)


def test_fewer_words_than_the_weights_know_are_refused(weights, tmp_path):
    small = dataclasses.replace(ROOMY, vocabulary_size=3)
    config = tiny_shape_run(tmp_path, start_from=weights, model=small)
    with pytest.raises(UserError, match=r"words\.weight"):
        fill(ShapeTask(config, stub_source, WORDS).make_model(), start_weights(config))


def test_without_weights_there_is_nothing_to_start_from(tmp_path):
    assert start_weights(tiny_shape_run(tmp_path)) is None


def test_a_missing_folder_is_named(tmp_path):
    with pytest.raises(UserError, match="nowhere"):
        open_run(tiny_shape_run(tmp_path, start_from=tmp_path / "nowhere"), WORDS)


def test_more_blocks_than_the_weights_have_change_nothing_at_first(tmp_path, weights):
    config = tiny_shape_run(tmp_path, start_from=weights)
    blocks = tuple(count + 1 for count in config.model.blocks)
    deeper = dataclasses.replace(config, model=dataclasses.replace(config.model, blocks=blocks))
    plain, more = (
        ShapeTask(chosen, stub_source, WORDS).make_model().eval() for chosen in (config, deeper)
    )
    generator = torch.Generator().manual_seed(0)
    start = start_weights(config)
    state = {k: 0.3 * torch.randn(v.shape, generator=generator) for k, v in start.state.items()}
    for model in (plain, more):
        fill(model, dataclasses.replace(start, state=state))
    assert sum(1 for _ in more.parameters()) > sum(1 for _ in plain.parameters())
    volumes = torch.rand(1, SOURCES, 4, CELLS, CELLS, CELLS, generator=generator)
    evidence = torch.rand(1, 3, COARSE_CELLS, COARSE_CELLS, COARSE_CELLS, generator=generator)
    asked = (volumes, evidence, torch.ones(1, COPIES), torch.tensor([[FIRST_WORD_TOKEN]]))
    with torch.no_grad():
        expected = plain(*asked).occupancy
        torch.testing.assert_close(more(*asked).occupancy, expected, rtol=0, atol=0)
    assert expected.std() > 0.1
