import json

import numpy as np
import pytest
from PIL import Image

from gscomplete.errors import UserError
from gscomplete.priors.embedded.prior import EmbeddedPrior
from recipes.train_embedded_prior import samples
from recipes.train_embedded_prior.samples import Options
from tests.builders.tiny_denoiser import tiny_config, tiny_model


@pytest.fixture(scope="module")
def prior():
    return EmbeddedPrior(tiny_model(), tiny_config(), precision="float32")


def test_prompts_are_those_given_or_captions(tmp_path):
    out = tmp_path / "sheet.png"
    assert samples.prompts_of(Options(out, prompts=("a mug",))) == {"a mug": "a mug"}
    found = samples.prompts_of(Options(out, families=("mug", "chair")))
    assert list(found) == ["mug", "chair"]
    assert all(len(caption.split()) > 1 for caption in found.values())
    with pytest.raises(UserError, match="--meshes"):
        samples.prompts_of(Options(out, nouns=5))


def test_a_sample_is_told_the_known_shape_of_its_noun_or_not(prior):
    assert samples.told_of(prior, "a red chair", known_shapes=True).shape is not None
    assert samples.told_of(prior, "a red chair", known_shapes=False).shape is None
    assert samples.told_of(prior, "a qwertzuiop", known_shapes=True).shape is None


def test_samples_depend_on_what_is_told_and_the_seed(prior, tmp_path):
    options = Options(tmp_path / "sheet.png", steps=2)
    plain = samples.told_of(prior, "a red chair", known_shapes=False)
    shown = samples.told_of(prior, "a red chair", known_shapes=True)
    other_seed = Options(tmp_path / "sheet.png", steps=2, seed=1)
    first = samples.sample(prior, plain, options).color
    assert np.array_equal(first, samples.sample(prior, plain, options).color)
    assert not np.array_equal(first, samples.sample(prior, plain, other_seed).color)
    assert not np.array_equal(first, samples.sample(prior, shown, options).color)


def test_blind_pictures_are_numbered_and_their_key_is_right(tmp_path):
    rows = {name: [Image.new("RGB", (8, 8), (40 * k, 0, 0))] * 4 for k, name in enumerate("abcde")}
    samples.save_blind(tmp_path / "blind", rows, 0)
    key = json.loads((tmp_path / "blind" / "key.json").read_text())
    assert sorted(key.values()) == list("abcde")
    assert list(key.values()) != list("abcde")
    for number, name in key.items():
        picture = np.asarray(Image.open(tmp_path / "blind" / f"{number}.png"))
        red = 40 * "abcde".index(name)
        assert (picture == (red, 0, 0)).all(axis=-1).mean() > 0.5
