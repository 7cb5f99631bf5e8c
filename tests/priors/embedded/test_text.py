import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gscomplete.priors.embedded.text import (
    FIRST_WORD_TOKEN,
    NO_TEXT_TOKEN,
    PAD_TOKEN,
    Tokenizer,
    build_words,
    no_text_like,
    understood_by,
)

TOKENIZER = Tokenizer(("berry", "chair", "gray", "mug", "red", "rock", "wooden", "with"), 4)


def test_words_are_sorted_into_known_unknown_and_ignored():
    report = TOKENIZER.understood("A red Mug, with the frobnicator!")
    assert report.known == ("red", "mug", "with")  # "with" is in this vocabulary
    assert report.unknown == ("frobnicator",)
    assert report.ignored == ("a", "the")
    assert "frobnicator" in "".join(report.lines())


@pytest.mark.parametrize(
    ("written", "stored"),
    [
        ("mugs", "mug"),
        ("Berries", "berry"),
        ("rocking", "rock"),
        ("grey", "gray"),
        ("wood", "wooden"),
        ("RED", "red"),
        ("teacups", "mug"),
    ],
)
def test_simple_forms_are_found(written, stored):
    assert TOKENIZER.understood(written).known
    assert torch.equal(TOKENIZER.encode(written), TOKENIZER.encode(stored))


def test_hyphens_split():
    assert TOKENIZER.understood("rocking-chair").known == ("rocking", "chair")


def test_short_words_are_not_stemmed_to_others():
    assert TOKENIZER.lookup("reds") == TOKENIZER.lookup("red")
    assert TOKENIZER.lookup("re") is None
    assert TOKENIZER.lookup("mugging") is None


@pytest.mark.parametrize("prompt", ["", "   ", "zzz qqq", "the of a"])
def test_nothing_understood_is_no_text(prompt):
    assert TOKENIZER.encode(prompt).tolist() == [NO_TEXT_TOKEN, 0, 0, 0]
    assert "no known word in it" in TOKENIZER.understood(prompt).lines()[0]
    told = TOKENIZER.encode("a red mug")[None]
    assert torch.equal(no_text_like(told), TOKENIZER.encode(prompt)[None])


def test_long_prompts_report_what_is_dropped():
    report = TOKENIZER.understood("red mug red mug red chair")
    assert report.dropped == ("red", "chair")
    assert (TOKENIZER.encode("red mug red mug red chair") >= FIRST_WORD_TOKEN).all()


@given(st.text(max_size=200))
@settings(max_examples=100, deadline=None)
def test_any_text_gives_valid_tokens(prompt):
    tokens = TOKENIZER.encode(prompt)
    assert tokens.shape == (4,)
    assert tokens.dtype == torch.int64
    assert tokens[0] != PAD_TOKEN
    assert int(tokens.max()) < TOKENIZER.size


def test_build_words_is_sorted_and_free_of_stop_words():
    assert build_words(["a red mug", "the Blue-mug"]) == ["blue", "mug", "red"]


def test_repeated_words_are_refused():
    with pytest.raises(ValueError, match="twice"):
        Tokenizer(("mug", "mug"), 4)


@pytest.mark.parametrize("prompt", ["eine grüne Tür r", "toy R/C", "红色"])
def test_letters_are_not_made_words_that_nobody_wrote(prompt):
    report = TOKENIZER.understood(prompt)
    assert report.known == ()
    assert "".join(report.unknown) == "".join(prompt.lower().replace("/", " ").split())


def test_what_either_vocabulary_knows_is_understood():
    other = Tokenizer(("apple", "mug"), 4)
    report = understood_by((TOKENIZER, other), "a red apple beside a mug and a zeppelin")
    assert set(report.known) == {"red", "apple", "mug"}
    assert report.unknown == ("beside", "zeppelin")
    assert understood_by((TOKENIZER,), "a red mug") == TOKENIZER.understood("a red mug")
