"""Colours that a prompt names, for new splats of a part that has none of its own.

Conventions
-----------
* Colours change in Oklab (``splats.oklab``): hue, saturation and mean lightness become those of the
  colour named; each splat stays as much lighter or darker than the mean as it was.
"""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor

from gscomplete.shape.bank.nouns import adjectives_of
from gscomplete.splats import Splats, colors_to_sh
from gscomplete.splats.oklab import oklab_from_srgb, srgb_from_oklab
from gscomplete.util.same_bits import fixed_mean

_HUES = {
    "red": "b3241f",
    "orange": "e07b22",
    "yellow": "e3c22f",
    "green": "3a8a3c",
    "blue": "2b5fb0",
    "purple": "6d3a94",
    "pink": "e08aa8",
    "brown": "6e4527",
    "beige": "d2bd94",
    "gold": "c79a2e",
    "golden": "c79a2e",
    "turquoise": "35b1ab",
    "teal": "217a7c",
}
"""sRGB. Black, white and grey are left out: a part without colour has its own shade of grey."""
_COLOURLESS = 0.04
"""Mean distance from grey below which a part has no colour (Oklab)."""


def with_prompt_color(new: Splats, partial: Splats, prompt: str) -> tuple[Splats, tuple[str, ...]]:
    """Give new splats the colour that the prompt names, unless P has colours itself.

    Args:
        new: splats of harmonics' degree 0.
        partial: P.
        prompt: names the colour before its noun: "a red mug", not "a mug with a red handle".

    Returns:
        The splats, and what was done, for the user; nothing where the prompt names no colour.
    """
    named = [word for word in adjectives_of(prompt) if word in _HUES]
    if not named or not len(new):
        return new, ()
    if len(named) > 1:
        return new, (
            f"colours: new splats take P's, as the prompt names several: {', '.join(named)}",
        )
    (word,) = named
    lab = oklab_from_srgb(partial.base_colors.detach().cpu().clamp(0.0, 1.0))
    if float(fixed_mean(lab[:, 1:].norm(dim=1))) > _COLOURLESS:
        return new, (f"colours: new splats take P's own, whatever the prompt says ({word})",)
    recolored = _recolored(new.base_colors.detach().cpu().clamp(0.0, 1.0), _HUES[word])
    note = f"colours: P has none, so new splats are {word}, as in the prompt"
    return dataclasses.replace(new, sh=colors_to_sh(recolored.float())), (note,)


def _recolored(colors: Tensor, color: str) -> Tensor:  # [N, 3], six hexadecimal digits -> [N, 3]
    """Give colours one hue and mean lightness; their differences in lightness stay."""
    target = torch.tensor([[int(color[k : k + 2], 16) / 255 for k in (0, 2, 4)]])
    lab, wanted = oklab_from_srgb(colors), oklab_from_srgb(target)
    lightness = wanted[:, 0] + lab[:, 0] - fixed_mean(lab[:, 0])
    moved = torch.stack([lightness, *(wanted[:, k].expand(len(lab)) for k in (1, 2))], dim=1)
    return srgb_from_oklab(moved).clamp(0.0, 1.0)
