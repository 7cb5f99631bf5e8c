"""Names of an object's colours, for captions that do not mention them.

Conventions
-----------
* Colours are sRGB in [0, 1]. They are named in Oklab: those near the grey axis by lightness, others
  by the nearest of a few named colours, where hue counts most, so that a shaded red is still red.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from gscomplete.splats.oklab import oklab_from_srgb
from gscomplete.util.arrays import Float32Array

_HUES = {
    "red": "c8281e",
    "orange": "e8822a",
    "yellow": "e8cc32",
    "green": "3f9b43",
    "turquoise": "35b1ab",
    "blue": "2f62c0",
    "purple": "7a3fa5",
    "pink": "e892b0",
    "brown": "70452a",
    "beige": "d8c4a0",
}
_NAMES = (*_HUES, "black", "grey", "white")
_GREY_CHROMA = 0.03
_BLACK_BELOW, _WHITE_FROM = 0.32, 0.88
_FIRST_SHARE, _SECOND_SHARE = 0.4, 0.3
"""An object is named by a colour of at least this share of it, and by another."""
_HUE_COUNTS, _CHROMA_COUNTS, _LIGHTNESS_COUNTS = 0.15, 0.4, 0.3


def color_words(colors: Float32Array) -> tuple[str, ...]:  # [N, 3]
    """Return the names of the one or two colours that most of an object has, if any."""
    codes = [[int(code[k : k + 2], 16) / 255 for k in (0, 2, 4)] for code in _HUES.values()]
    hues = oklab_from_srgb(torch.tensor(codes))
    lab = oklab_from_srgb(torch.from_numpy(colors.clip(0, 1)))
    nearest = torch.cdist(_tellable(lab), _tellable(hues)).argmin(dim=1)
    edges = torch.tensor([_BLACK_BELOW, _WHITE_FROM], dtype=torch.float64)
    grey = len(_HUES) + torch.bucketize(lab[:, 0].contiguous(), edges)
    is_grey = lab[:, 1:].norm(dim=1) < _GREY_CHROMA
    name = torch.where(is_grey, grey, nearest).numpy()
    shares = np.bincount(name, minlength=len(_NAMES)) / len(name)
    first, second = np.argsort(-shares, kind="stable")[:2]
    if shares[first] < _FIRST_SHARE:
        return ()
    chosen = (first, second) if shares[second] >= _SECOND_SHARE else (first,)
    return tuple(_NAMES[k] for k in chosen)


def _tellable(lab: Tensor) -> Tensor:  # [N, 3] -> [N, 4]
    """Return colours with distances as names have them."""
    chroma = lab[:, 1:].norm(dim=1, keepdim=True)
    hue = lab[:, 1:] / chroma.clamp_min(1e-6)
    lightness = _LIGHTNESS_COUNTS * lab[:, :1]
    return torch.cat([_HUE_COUNTS * hue, _CHROMA_COUNTS * chroma, lightness], dim=1)


def with_color_words(caption: str, words: tuple[str, ...]) -> str:
    """Return a caption that mentions these colours and no others."""
    others = (word for word in caption.split() if word not in _NAMES)
    return " ".join([" and ".join(words), *others]).strip()
