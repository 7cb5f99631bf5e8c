import numpy as np
import pytest

from recipes.train_embedded_prior.data.color_words import color_words, with_color_words


def painted(*parts):
    """Rows of (colour, how many)."""
    return np.concatenate([np.tile(np.array(color, float) / 255, (n, 1)) for color, n in parts])


@pytest.mark.parametrize(
    ("color", "name"),
    [
        ((200, 40, 30), "red"),
        ((110, 22, 18), "red"),
        ((60, 110, 200), "blue"),
        ((150, 190, 220), "blue"),
        ((60, 150, 60), "green"),
        ((240, 210, 60), "yellow"),
        ((230, 130, 40), "orange"),
        ((110, 70, 45), "brown"),
        ((10, 10, 10), "black"),
        ((90, 90, 92), "grey"),
        ((150, 150, 150), "grey"),
        ((250, 250, 250), "white"),
    ],
)
def test_plain_colours_have_their_names(color, name):
    assert color_words(painted((color, 10))) == (name,)


def test_two_colours_are_told_the_commoner_first_and_many_not_at_all():
    red, white, blue, green = (200, 40, 30), (250, 250, 250), (47, 98, 192), (60, 150, 60)
    assert color_words(painted((white, 6), (red, 10))) == ("red", "white")
    assert color_words(painted((white, 2), (red, 10))) == ("red",)
    assert color_words(painted((red, 3), (white, 3), (blue, 3), (green, 3))) == ()


def test_a_caption_tells_these_colours_and_no_others():
    assert with_color_words("red fire hydrant", ("blue", "white")) == "blue and white fire hydrant"
    assert with_color_words("fire hydrant", ()) == "fire hydrant"
    assert with_color_words("red hydrant", ()) == "hydrant"
