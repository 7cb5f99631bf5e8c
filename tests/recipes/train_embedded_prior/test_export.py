import torch

from gscomplete.priors import load_prior
from gscomplete.priors.embedded.weights import load_weights
from recipes.train_embedded_prior.export import card, export, keep_words, words_seen
from recipes.train_embedded_prior.state import TrainState
from tests.recipes.train_embedded_prior.stub import WORDS, tiny_run


def test_only_words_seen_in_captions_are_kept():
    assert words_seen(WORDS, ["a red ball", "the red thing"]) == ("ball", "red")


def test_kept_words_keep_their_embeddings(tmp_path):
    state = TrainState.start(tiny_run(tmp_path)).ema.state_dict()
    kept = keep_words(state, WORDS, ("red",))
    name = "text.words.weight"
    assert torch.equal(kept[name], state[name][[0, 1, 2 + WORDS.index("red")]])


def test_exported_weights_make_a_prior(tmp_path):
    config = tiny_run(tmp_path)
    state = TrainState.start(config)
    state.step = 7
    written = export(config, state, WORDS, ("ball", "red"), tmp_path / "out", "int8")
    model, read = load_weights(tmp_path / "out")
    assert read == written
    assert read.training.sets == 14
    prior = load_prior(str(tmp_path / "out"))
    assert prior.views.resolution_px == config.model.resolution_px
    assert "unknown to this prior: blue" in " ".join(prior.condition("a blue ball").report)
    losses = {"stored": {"input_mean": 0.1, "text_mean": 0.2}}
    text = card(read, model, losses)
    assert "| stored | 0.1000 | 0.2000 |" in text
    assert "7 steps, 14 four-view sets" in text
