import pytest

from gscomplete.errors import UserError
from gscomplete.util.parse import parse_numbers, parse_view, with_new_names


@pytest.mark.parametrize("word", ["--size", "--size=2"])
def test_an_old_name_of_an_option_is_understood_with_a_note(capsys, word):
    found = with_new_names(["mug.ply", word, "2"], {"--size": "--object-size"})
    assert found == ["mug.ply", word.replace("--size", "--object-size"), "2"]
    assert "--size is now called --object-size" in capsys.readouterr().err


def test_other_words_stay_as_they_are(capsys):
    words = ["--size-px", "64", "--prompt=--size", "size"]
    assert with_new_names(words, {"--size": "--object-size"}) == words
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("text", ["", "1", "1,2,3", "a,b", "1,inf", "1,nan"])
def test_numbers_of_another_form_are_refused(text):
    with pytest.raises(UserError, match="--view: expected AZIMUTH,ELEVATION, 2 finite numbers"):
        parse_view(text)


def test_none_stays_none():
    assert parse_numbers(None, 2, "--view", "A,B") is None
