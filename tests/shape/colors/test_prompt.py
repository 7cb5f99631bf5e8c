import pytest
import torch

from gscomplete.shape.colors.prompt import _HUES, with_prompt_color
from gscomplete.splats.oklab import oklab_from_srgb
from tests.builders.objects import round_splats


def colored(*colors):
    return round_splats(torch.zeros(len(colors), 3), color=torch.tensor(colors))


GREY = colored((0.5, 0.5, 0.5), (0.6, 0.6, 0.6))
WHITE_TO_GREY = colored((0.9, 0.9, 0.9), (0.7, 0.7, 0.7), (0.5, 0.5, 0.5))


@pytest.mark.parametrize("word", _HUES)
def test_new_splats_take_the_colour_named_and_keep_their_shading(word):
    found, notes = with_prompt_color(WHITE_TO_GREY, GREY, f"a {word} mug")
    assert f"new splats are {word}" in notes[0]
    lab = oklab_from_srgb(found.base_colors)
    hue = torch.atan2(lab[:, 2], lab[:, 1])
    code = _HUES[word]
    target = torch.tensor([[int(code[k : k + 2], 16) / 255 for k in (0, 2, 4)]])
    wanted = oklab_from_srgb(target)[0]
    middle = lab[1]
    # what is lighter or darker may leave sRGB and is cut; the middle one is the colour itself
    assert torch.allclose(middle, wanted, atol=0.05)
    assert (torch.cos(hue - hue[1]) > 0.8).all()
    assert lab[0, 0] > lab[1, 0] > lab[2, 0]
    assert torch.equal(found.means, WHITE_TO_GREY.means)


@pytest.mark.parametrize(
    ("prompt", "partial"),
    [
        ("a red mug", colored((0.2, 0.3, 0.8), (0.2, 0.3, 0.7))),  # P is blue
        ("a mug", GREY),
        ("a mug with a red handle", GREY),
        ("a grey mug", GREY),
        ("a red and blue ball", GREY),
    ],
)
def test_all_else_leaves_colours_as_they_are(prompt, partial):
    found, notes = with_prompt_color(WHITE_TO_GREY, partial, prompt)
    assert torch.equal(found.sh, WHITE_TO_GREY.sh)
    names_hues = (
        any(f" {word} " in f"{prompt} " for word in ("red", "blue")) and "with" not in prompt
    )
    assert bool(notes) == names_hues


def test_no_new_splats_are_none_in_colour():
    nothing = GREY.select(torch.arange(0))
    assert with_prompt_color(nothing, GREY, "a red mug") == (nothing, ())
