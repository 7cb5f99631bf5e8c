import pytest

from gscomplete.errors import UserError
from gscomplete.util.parse import (
    has_controls,
    parse_numbers,
    parse_view,
    require_prompt,
    shown_text,
    with_new_names,
    with_signs_joined,
)


@pytest.mark.parametrize("word", ["--size", "--size=2"])
def test_an_old_name_of_an_option_is_understood_with_a_note(capsys, word):
    found = with_new_names(["mug.ply", word, "2"], {"--size": "--object-size"})
    assert found == ["mug.ply", word.replace("--size", "--object-size"), "2"]
    assert "--size is now called --object-size" in capsys.readouterr().err


def test_other_words_stay_as_they_are(capsys):
    words = ["--size-px", "64", "--prompt=--size", "size"]
    assert with_new_names(words, {"--size": "--object-size"}) == words
    assert capsys.readouterr().err == ""


def test_values_that_begin_with_a_minus_belong_to_their_option():
    words = ["a.ply", "--up", "-Y", "--view", "-30,10", "--json", "--center", "-.5,0,0", "-x", "-1"]
    expected = ["a.ply", "--up=-Y", "--view=-30,10", "--json", "--center=-.5,0,0", "-x", "-1"]
    assert with_signs_joined(words) == expected
    assert with_signs_joined(["--up=X", "-Y"]) == ["--up=X", "-Y"]


@pytest.mark.parametrize("text", ["", "1", "1,2,3", "a,b", "1,inf", "1,nan"])
def test_numbers_of_another_form_are_refused(text):
    with pytest.raises(UserError, match="--view: expected AZIMUTH,ELEVATION, 2 finite numbers"):
        parse_view(text)


def test_none_stays_none():
    assert parse_numbers(None, 2, "--view", "A,B") is None


@pytest.mark.parametrize("control", ["\x1b", "\n", "\x00", "\x7f", "\x9b", "\u2028", "\u202e"])
def test_a_prompt_of_control_characters_is_refused(control):
    prompt = f"a {control}[31mmug"
    assert has_controls(prompt)
    with pytest.raises(UserError, match="--prompt: expected a text without control") as told:
        require_prompt(prompt)
    assert not has_controls(str(told.value))


def test_other_characters_are_no_matter():
    for prompt in (
        "une tasse à café",
        "赤い\u3000カップ",
        "كوب",
        "a \U0001f469\u200d\U0001f373",
    ):
        require_prompt(prompt)
        assert shown_text(prompt) == prompt


def test_control_characters_are_shown_and_not_obeyed():
    assert shown_text("a\x1b[31m\u202eb\r\n\tc") == "a\\x1b[31m\\u202eb\\r\n\tc"
