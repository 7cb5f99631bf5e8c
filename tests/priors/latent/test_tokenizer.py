import gzip

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("ftfy", reason="the extra gscomplete[mvdream] is not installed")
pytest.importorskip("regex", reason="the extra gscomplete[mvdream] is not installed")

from gscomplete.priors.latent import tokenizer
from gscomplete.priors.latent.tokenizer import END_ID, START_ID, Tokenizer

ASTRONAUT = (49406, 550, 18376, 6765, 320, 4558, 267, 274, 323, 13039, 49407)
PROMPTS = (
    "a red mug",
    "an astronaut riding a horse, 3d asset",
    "It's the  DOG's   bowl!!! (1984)  ",
    "I'd we'll they've she'd can't you're I'm",
    "crème brûlée à la carte",
    "ein Würfel aus Holz; größer als 12cm",
    "日本の茶碗",
    "mug_with_underscores and-hyphens/slashes",
    "emoji 🐉🔥 dragon",
    "x²+y³=½ ٣",
    "supercalifragilisticexpialidocious antidisestablishmentarianism",
)


def test_ids_of_the_specification():
    found = Tokenizer().encode("an astronaut riding a horse, 3d asset")
    assert found.ids == ASTRONAUT + (0,) * 66
    assert Tokenizer().encode("").ids == (49406, 49407) + (0,) * 75


def test_text_is_repaired_and_lowered():
    encode = Tokenizer().encode
    assert encode("  A\nRED\t mug ") == encode("a red mug")
    assert encode("salt &amp;amp; pepper") == encode("salt & pepper")
    assert encode("cafÃ©") == encode("café")


def test_padding_can_be_openai_s():
    assert Tokenizer(pad_id=END_ID).encode("a mug").ids[-1] == END_ID
    assert Tokenizer().encode("a mug").ids[-1] == 0


def test_long_text_is_cut_with_the_end_kept():
    found = Tokenizer().encode("mug " * 100)
    assert len(found.ids) == 77
    assert (found.ids[0], found.ids[-1]) == (START_ID, END_ID)
    assert found.dropped == 25
    assert Tokenizer().encode("mug " * 75).dropped == 0


@given(st.text(max_size=60))
def test_any_text_gives_valid_ids(text):
    found = Tokenizer().encode(text)
    assert len(found.ids) == 77
    assert all(0 <= token <= END_ID for token in found.ids)
    end = found.ids.index(END_ID)
    assert START_ID not in found.ids[1:]
    assert set(found.ids[end + 1 :]) <= {0}
    assert found.tensor().shape == (1, 77)


def test_same_ids_as_transformers():
    """Its tokenizer, given our vocabulary, up to padding (padding with "!" breaks its "!!!")."""
    transformers = pytest.importorskip("transformers", minversion="5.0")
    lines = gzip.decompress(tokenizer._MERGES.read_bytes()).decode().splitlines()
    merges = [tuple(line.split(" ")) for line in lines]
    _, ids, _ = tokenizer._vocabulary()
    theirs = transformers.CLIPTokenizer(
        vocab=ids | {"<|startoftext|>": START_ID, "<|endoftext|>": END_ID}, merges=merges
    )
    for prompt in PROMPTS:
        expected = theirs(prompt).input_ids
        assert list(Tokenizer().encode(prompt).ids)[: len(expected)] == expected, prompt
