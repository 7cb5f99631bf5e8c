import pytest
from hypothesis import given
from hypothesis import strategies as st

from gscomplete.shape.bank.nouns import _GROUP_OF, adjectives_of, head_noun, synonyms_of


@pytest.mark.parametrize(
    ("prompt", "noun"),
    [
        ("a blue mug with a handle", "mug"),
        ("A pale yellow bowl upside down", "bowl"),
        ("a red and white box", "box"),
        ("statue of a seated figure", "statue"),
        ("chair", "chair"),
        ("the", None),
        ("", None),
        ("123 ...", None),
        ("android figure orange", None),
        ("a chair, blue", "chair"),
        ("an orange", "orange"),
        ("a toy", None),
        ("the rest of a chair", "chair"),
        ("a bench made of wood", "bench"),
        ("a cup of tea", "cup"),
        ("half of", None),
    ],
)
def test_the_noun_is_what_the_first_preposition_follows(prompt, noun):
    assert head_noun(prompt) == noun


@pytest.mark.parametrize(
    ("prompt", "adjectives"),
    [
        ("a dark red mug with a blue handle", ["dark", "red"]),
        ("a chair, blue", ["blue"]),
        ("an orange", []),
        ("half of a green apple", ["green"]),
        ("chair", []),
        ("", []),
    ],
)
def test_adjectives_are_what_else_stands_before_the_first_preposition(prompt, adjectives):
    assert adjectives_of(prompt) == adjectives


@given(st.text(max_size=60))
def test_any_text_has_a_noun_of_its_own_or_none(text):
    noun = head_noun(text)
    assert noun is None or noun in text.lower()


def test_synonyms_are_mutual_and_nobodys_own():
    assert "sofa" in synonyms_of("couch")
    assert synonyms_of("unicorn") == ()
    for word, others in _GROUP_OF.items():
        assert word not in others
        assert all(word in synonyms_of(other) for other in others)
