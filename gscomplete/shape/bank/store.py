"""The bank of known shapes on disk: surfaces of free meshes as bits, with what they are called.

Conventions
-----------
* A shape's frame: z up, box centred, longest side 1; ``BANK_CELLS`` cells along each axis of that
  cube, indexed [x, y, z]; a cell is marked where the surface passes it.
* ``shapes.safetensors`` holds the packed bits of every shape deflated one by one (``blob``, from
  ``offsets``), so that only shapes that are asked for are unpacked; ids, nouns and captions are
  lists in the file's metadata.
"""

from __future__ import annotations

import functools
import json
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from gscomplete.errors import UserError
from gscomplete.shape.bank.nouns import forms_of, head_noun, synonyms_of, words_of
from gscomplete.util.arrays import BoolArray, IntArray
from gscomplete.util.atomic import atomic_path

BANK_FILE = "shapes.safetensors"
BANK_CELLS = 48
_BITS = BANK_CELLS**3 // 8
_HEAD_SCORE, _SYNONYM_SCORE, _WORD_SCORE, _OTHER_SCORE = 3.0, 2.5, 2.0, 0.3
"""Scores, which add up: the shape's noun is the prompt's, or else a synonym; the prompt's noun is
among the words of its noun or caption; each further word that they share with the prompt."""


Naming = Literal["noun", "synonym", "caption"]


@dataclass(frozen=True, slots=True)
class ShapeName:
    """What a known shape is called."""

    id: str
    noun: str
    caption: str

    @property
    def pack(self) -> str:
        """The pack that the shape comes from, all by one maker: the first part of its id."""
        return self.id.split("/")[0]


class ShapeBank:
    """Known shapes; surfaces are unpacked when they are asked for."""

    def __init__(
        self,
        names: Sequence[ShapeName],
        blob: NDArray[np.uint8],  # [B]
        offsets: IntArray,  # [N + 1]
    ) -> None:
        """Index the names.

        Raises:
            ValueError: names and offsets do not go together.
        """
        if len(offsets) != len(names) + 1 or offsets[0] != 0 or (np.diff(offsets) < 0).any():
            raise ValueError(f"expected rising offsets of {len(names)} shapes")
        if offsets[-1] != len(blob):
            raise ValueError(f"expected {offsets[-1]} bytes of shapes, found {len(blob)}")
        self.names = tuple(names)
        self._blob, self._offsets = blob, offsets
        self._heads = [words_of(name.noun)[-1:] for name in self.names]
        self._words = [frozenset(words_of(f"{name.noun} {name.caption}")) for name in self.names]

    def __len__(self) -> int:
        """Return the number of shapes."""
        return len(self.names)

    def surface(self, index: int) -> BoolArray:  # [C, C, C]
        """Unpack one shape.

        Raises:
            UserError: the bits are damaged.
        """
        stored = self._blob[self._offsets[index] : self._offsets[index + 1]].tobytes()
        try:
            bits = zlib.decompressobj().decompress(stored, _BITS + 1)
        except zlib.error as error:
            raise UserError(f"{BANK_FILE}: {self.names[index].id}: damaged ({error})") from error
        if len(bits) != _BITS:
            raise UserError(
                f"{BANK_FILE}: {self.names[index].id}: expected {_BITS} bytes, found {len(bits)}"
            )
        flat = np.unpackbits(np.frombuffer(bits, np.uint8)).astype(bool)
        return flat.reshape((BANK_CELLS,) * 3)

    def named(self, prompt: str, limit: int) -> list[int]:
        """Return the shapes that the prompt's noun names, the best matches first.

        Args:
            prompt: any text; the noun is :func:`head_noun`.
            limit: most shapes.
        """
        noun = head_noun(prompt)
        if noun is None:
            return []
        forms, alike = _forms_and_synonyms(noun)
        others = set(words_of(prompt)) - forms
        scores = []
        for head, words in zip(self._heads, self._words, strict=True):
            by_noun = _HEAD_SCORE * bool(forms.intersection(head))
            by_noun = by_noun or _SYNONYM_SCORE * bool(alike.intersection(head))
            by_word = _WORD_SCORE * bool(forms & words)
            scores.append(
                (by_noun + by_word) and by_noun + by_word + _OTHER_SCORE * len(others & words)
            )
        order = np.argsort(-np.array(scores), kind="stable")[:limit]
        return [int(k) for k in order if scores[k] > 0]

    def plainest(self, prompt: str) -> int | None:
        """Return the shape whose name adds least to the prompt's noun; None = none has the noun.

        So "a pumpkin" does not get a pumpkin carriage, nor "a cushion" an armchair with cushions.
        """
        told = frozenset(words_of(prompt)) | forms_of(head_noun(prompt) or "")

        def unasked(index: int) -> tuple[int, int]:
            by_name = ("noun", "synonym", "caption").index(self.naming(index, prompt))
            return by_name, len(self._words[index] - told)

        return min(self.named(prompt, len(self)), key=unasked, default=None)

    def naming(self, index: int, prompt: str) -> Naming:
        """Return how the prompt names a shape: by its noun, a synonym, or a word of its caption."""
        noun = head_noun(prompt)
        if noun is None:
            return "caption"
        forms, alike = _forms_and_synonyms(noun)
        if forms.intersection(self._heads[index]):
            return "noun"
        return "synonym" if alike.intersection(self._heads[index]) else "caption"


def _forms_and_synonyms(noun: str) -> tuple[frozenset[str], frozenset[str]]:
    """Return the noun's own forms, and other words for it."""
    forms = forms_of(noun)
    return forms, frozenset(word for form in forms for word in synonyms_of(form))


def write_bank(path: Path, names: Sequence[ShapeName], surfaces: Sequence[BoolArray]) -> None:
    """Write a bank.

    Args:
        path: of the file.
        names: of the shapes.
        surfaces: [C, C, C] each.
    """
    packed = [zlib.compress(np.packbits(surface).tobytes(), 9) for surface in surfaces]
    offsets = np.concatenate([[0], np.cumsum([len(p) for p in packed])]).astype(np.int64)
    tensors = {
        "blob": torch.from_numpy(np.frombuffer(b"".join(packed), np.uint8).copy()),
        "offsets": torch.from_numpy(offsets),
    }
    columns = {
        field: json.dumps([getattr(name, field) for name in names])
        for field in ("id", "noun", "caption")
    }
    with atomic_path(path) as temporary:
        temporary.write_bytes(save(tensors, metadata={"cells": str(BANK_CELLS), **columns}))


@functools.cache
def read_bank(path: Path) -> ShapeBank:
    """Read a bank.

    Raises:
        UserError: the file is damaged or of another kind.
    """
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            blob = file.get_tensor("blob").numpy()
            offsets = file.get_tensor("offsets").numpy()
        columns = [json.loads(metadata[field]) for field in ("id", "noun", "caption")]
        names = [ShapeName(*map(str, row)) for row in zip(*columns, strict=True)]
        if metadata["cells"] != str(BANK_CELLS):
            raise ValueError(f"cells: expected {BANK_CELLS}, found {metadata['cells']}")
        return ShapeBank(names, blob, offsets)
    except (SafetensorError, OSError, KeyError, ValueError, TypeError) as error:
        raise UserError(f"{path}: expected a bank of shapes, found damage ({error})") from error
