import dataclasses
from types import SimpleNamespace

import pytest
import torch

from gscomplete.errors import UserError
from gscomplete.priors import load_prior
from gscomplete.priors.embedded.weights import load_weights, packaged_weights
from gscomplete.shape.bank.store import BANK_FILE, read_bank
from gscomplete.shape.network import ShapeCompleter
from gscomplete.shape.symmetry import COPIES, SOURCES
from gscomplete.shape.voxels import CELLS, COARSE_CELLS
from recipes.train_embedded_prior.card import card
from recipes.train_embedded_prior.data.mesh_pack import PackEntry
from recipes.train_embedded_prior.export import (
    ExportConfig,
    TrainedRun,
    blended,
    export,
    export_runs,
    words_seen,
)
from recipes.train_embedded_prior.shape_task import ShapeTask
from recipes.train_embedded_prior.state import TrainState, open_run
from recipes.train_embedded_prior.views_task import ViewsTask
from tests.builders.training import WORDS, stub_source, tiny_run, tiny_shape_run


def trained(task, steps=0):
    """Write a run folder as the trainer leaves it, and read it."""
    open_run(task.config, task.words)
    state = TrainState.start(task.config, task.make_model)
    state.step = steps
    state.save(task.config.out)
    return TrainedRun.load(task.config.out)


def exported(views, shape, kept, out, storage):
    framing = views.config.data.views(views.config.model.resolution_px)
    part = None if shape is None else shape.exportable().with_words(kept)
    return export(views.exportable().with_words(kept), framing, part, out, storage)


def test_only_words_seen_in_captions_are_kept():
    assert words_seen(WORDS, ["a red ball", "the red thing"]) == ("ball", "red")


def test_kept_words_keep_their_embeddings(tmp_path):
    views = trained(ViewsTask(tiny_run(tmp_path / "a"), stub_source, WORDS))
    shape = trained(ShapeTask(tiny_shape_run(tmp_path / "b"), stub_source, WORDS))
    rows = [0, 1, 2 + WORDS.index("red")]
    for run, name in ((views, "text.words.weight"), (shape, "words.weight")):
        everything = run.state.ema.state_dict()
        assert torch.equal(run.exportable().weights(("red",))[name], everything[name][rows])


def test_exported_weights_make_a_prior(tmp_path):
    views = trained(ViewsTask(tiny_run(tmp_path / "a"), stub_source, WORDS), steps=7)
    shape = trained(ShapeTask(tiny_shape_run(tmp_path / "b"), stub_source, WORDS), steps=5)
    written = exported(views, shape, ("ball", "red"), tmp_path / "out", "int8")
    model, shape_model, read = load_weights(tmp_path / "out")
    assert read == written
    assert shape_model is not None
    assert read.training.sets == 14
    prior = load_prior(str(tmp_path / "out"))
    assert prior.views.resolution_px == views.config.model.resolution_px
    assert "unknown to this prior: blue" in " ".join(prior.condition("a blue ball").report)
    losses = {"stored": {"input_mean": 0.1, "shape_mean": 0.3, "text_mean": 0.2}}
    text = card(read, model, shape_model, losses, {"iou": 0.5}, "one seed was changed")
    assert "| stored | 0.1000 | 0.3000 | 0.2000 |" in text
    assert "7 steps, 14 four-view sets" in text
    assert "Held-out iou: 0.5000" in text
    assert "History: one seed was changed" in text
    assert "Known shapes" not in text
    named = read_bank(packaged_weights() / BANK_FILE)
    text = card(read, model, shape_model, losses, {}, bank=named)
    assert f"surfaces of {len(named.names)} free meshes" in text


def test_weights_on_the_way_lie_between_both_ends(tmp_path):
    """A deeper network with more words, blended to nothing, answers as the one before it."""
    before = trained(ShapeTask(tiny_shape_run(tmp_path / "a"), stub_source, WORDS)).exportable()
    sizes = dataclasses.replace(before.model, blocks=(1, 1, 2), vocabulary_size=9)
    config = tiny_shape_run(tmp_path / "b", model=sizes, seed=1)
    after = trained(ShapeTask(config, stub_source, (*WORDS, "green"))).exportable()
    after.state["up.2.1.conv_out.weight"].normal_()  # as training makes of the new block's zeros

    def answer(state, model):
        network = ShapeCompleter(model, COARSE_CELLS)
        network.load_state_dict(state)
        g = torch.Generator().manual_seed(0)
        volumes = torch.rand(1, SOURCES, 4, CELLS, CELLS, CELLS, generator=g)
        evidence = torch.rand(1, 3, *(COARSE_CELLS,) * 3, generator=g)
        with torch.no_grad():
            return network.eval()(volumes, evidence, torch.ones(1, COPIES), torch.tensor([[2, 4]]))

    start, end = blended(after, before, 0.0), blended(after, before, 1.0)
    ours, theirs = answer(start.state, sizes), answer(before.state, before.model)
    torch.testing.assert_close(ours.colors, theirs.colors)
    torch.testing.assert_close(ours.sources, theirs.sources)
    assert all(torch.equal(end.state[name], value) for name, value in after.state.items())
    middle = blended(after, before, 0.25).state
    name = "down.0.0.conv_in.weight"
    torch.testing.assert_close(middle[name], 0.75 * before.state[name] + 0.25 * after.state[name])
    assert torch.equal(middle["words.weight"][5:], after.state["words.weight"][5:])
    with pytest.raises(UserError, match="did not start from"):
        blended(before, after, 0.5)


def test_a_share_is_one_of_the_way(tmp_path):
    with pytest.raises(UserError, match="expected above 0, at most 1"):
        export_runs(ExportConfig(shape_run=tmp_path, shape_share=1.5))


def test_weights_without_a_shape_network_make_a_prior_that_does_not_guess(tmp_path):
    views = trained(ViewsTask(tiny_run(tmp_path / "a"), stub_source, WORDS))
    exported(views, None, WORDS, tmp_path / "out", "float16")
    assert load_weights(tmp_path / "out")[1] is None


def test_the_denoiser_can_be_kept_while_the_shape_network_is_trained_on(tmp_path, monkeypatch):
    """Nothing of the denoiser changes; the record counts the steps before and after; words that
    were known stay, whatever the captions hold."""
    views = trained(ViewsTask(tiny_run(tmp_path / "a"), stub_source, WORDS), steps=7)
    shape = trained(ShapeTask(tiny_shape_run(tmp_path / "b"), stub_source, WORDS), steps=5)
    out = tmp_path / "out"
    exported(views, shape, WORDS, out, "int8")
    before = load_weights(out)[0].state_dict()
    going_on = tiny_shape_run(tmp_path / "c", start_from=out)
    trained(ShapeTask(going_on, stub_source, WORDS), steps=3)
    monkeypatch.setattr(
        "recipes.train_embedded_prior.export.make_object",
        lambda seed, index: SimpleNamespace(caption=WORDS[0]),
    )
    options = ExportConfig(shape_run=tmp_path / "c", out=out, words_from=1)
    run, left_out = export_runs(options)
    model, _, config = load_weights(out)
    assert run is None
    assert not left_out
    assert config.shape is not None
    assert config.shape.words == WORDS
    assert all(torch.equal(value, before[name]) for name, value in model.state_dict().items())
    assert config.training.steps == 7
    assert config.shape.training.steps == 8
    assert config.shape.training.sets == 16


def test_the_shape_network_can_be_kept_while_the_denoiser_is_trained_on(tmp_path):
    """Its words stay, and the denoiser has its own, so nothing of its answers changes."""
    views = trained(ViewsTask(tiny_run(tmp_path / "a"), stub_source, WORDS), steps=7)
    shape = trained(ShapeTask(tiny_shape_run(tmp_path / "b"), stub_source, WORDS), steps=5)
    out = tmp_path / "out"
    exported(views, shape, ("ball", "red"), out, "int8")
    _, kept, config = load_weights(out)
    assert kept is not None
    going_on = trained(ViewsTask(tiny_run(tmp_path / "c"), stub_source, WORDS), steps=3)
    run, left_out = export_runs(ExportConfig(run=tmp_path / "c", out=out, words_from=300))
    model, again, written = load_weights(out)
    assert again is not None
    assert run is not None
    assert written.shape == config.shape
    assert written.shape.words == ("ball", "red")
    assert "blue" in written.words
    assert left_out.isdisjoint(written.words)
    before = kept.state_dict()
    assert all(torch.equal(value, before[name]) for name, value in again.state_dict().items())
    trained_rows = going_on.exportable().weights(written.words)["text.words.weight"]
    # Eight bits hold 127 steps of a row's largest weight.
    error = (model.state_dict()["text.words.weight"] - trained_rows).abs().amax(dim=1)
    assert (error <= trained_rows.abs().amax(dim=1) / 127).all()


def test_an_export_of_nothing_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(UserError, match="expected --run, --shape-run or both"):
        export_runs(ExportConfig(out=tmp_path))
    assert not list(tmp_path.iterdir())


def test_the_card_names_sources_and_the_authors_whose_licence_asks_for_it(tmp_path):
    views = trained(ViewsTask(tiny_run(tmp_path / "a"), stub_source, WORDS))
    config = exported(views, None, ("ball",), tmp_path / "out", "int8")
    model, _, _ = load_weights(tmp_path / "out")
    rows = [("CC0", "me"), ("CC-BY-3.0", '"Can</name> <author> <name>Ann"'), ("CC-BY-3.0", "Bo")]
    meshes = [
        PackEntry(str(k), "train", "box", "a box", "one", licence, author, "flat")
        for k, (licence, author) in enumerate(rows)
    ]
    text = card(config, model, None, {}, {}, meshes={"denoiser": meshes})
    assert "the denoiser also on free meshes" in text
    assert "Meshes that the denoiser was trained on" in text
    assert "| one | 2 | CC-BY-3.0 |" in text
    assert "| one | 1 | CC0 |" in text
    assert "Authors of those under CC-BY: Ann, Bo." in text
    assert "sources" not in card(config, model, None, {}, {}).split("Licence")[1]
