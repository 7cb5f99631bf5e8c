"""CLIP's byte-pair encoding as OpenCLIP applies it: text to 77 token ids.

Conventions
-----------
* Text is repaired (ftfy), HTML entities are resolved twice, white space is collapsed, letters are
  lowered; then split into words, numbers digit by digit, and runs of other signs.
* Ids: 256 byte signs, the same ending a word, 48,894 merges in order, start 49406, end 49407.
* Padding is id 0 (the sign "!"), as OpenCLIP pads; CLIP elsewhere pads with the end token, and
  cross-attention sees all 77 positions, so the wrong padding moves every image.
* A text that is too long is cut, and its last id is the end token.
"""

from __future__ import annotations

import functools
import gzip
import html
import importlib
import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from gscomplete.errors import UserError

START_ID, END_ID = 49406, 49407
OPEN_CLIP_PAD_ID = 0

_MERGES = Path(__file__).resolve().parent / "vocabulary" / "clip_merges.txt.gz"
_WORDS = r"""'s|'t|'re|'ve|'m|'ll|'d|[\p{L}]+|[\p{N}]|[^\s\p{L}\p{N}]+"""
_END_OF_WORD = "</w>"


@dataclass(frozen=True, slots=True)
class Tokens:
    """A prompt as the text tower is given it."""

    ids: tuple[int, ...]
    """All ``length`` of them, padding included."""
    dropped: int
    """Ids that did not fit."""

    def tensor(self) -> Tensor:  # [1, length] int64
        """Return the ids as a batch of one."""
        return torch.tensor([self.ids], dtype=torch.int64)


class Tokenizer:
    """CLIP's vocabulary and how to cut text into it."""

    def __init__(self, length: int = 77, pad_id: int = OPEN_CLIP_PAD_ID) -> None:
        """Read the vocabulary that ships with the package.

        Args:
            length: ids per prompt.
            pad_id: what fills the rest; OpenCLIP's 0, or 49407 for OpenAI's CLIP.

        Raises:
            UserError: the packages ``regex`` or ``ftfy`` are missing.
        """
        self._length, self._pad_id = length, pad_id
        self._ranks, self._ids, self._signs = _vocabulary()
        self._pattern = _import("regex").compile(_WORDS, _import("regex").IGNORECASE)
        self._fix = _import("ftfy").fix_text

    def encode(self, text: str) -> Tokens:
        """Turn text into ids."""
        clean = html.unescape(html.unescape(self._fix(text)))
        words = self._pattern.findall(" ".join(clean.split()).lower())
        ids = [self._ids[piece] for word in words for piece in self._pieces(word)]
        room = self._length - 2
        kept = [START_ID, *ids[:room], END_ID]
        padding = [self._pad_id] * (self._length - len(kept))
        return Tokens((*kept, *padding), max(0, len(ids) - room))

    def _pieces(self, word: str) -> list[str]:
        """Join a word's bytes by the lowest-ranked merge until none applies."""
        pieces = [self._signs[byte] for byte in word.encode("utf-8")]
        pieces[-1] += _END_OF_WORD
        while len(pieces) > 1:
            pairs = list(itertools.pairwise(pieces))
            best = min(pairs, key=lambda pair: self._ranks.get(pair, len(self._ranks)))
            if best not in self._ranks:
                break
            joined, index = [], 0
            while index < len(pieces):
                if tuple(pieces[index : index + 2]) == best:
                    joined.append(best[0] + best[1])
                    index += 2
                else:
                    joined.append(pieces[index])
                    index += 1
            pieces = joined
        return pieces


@functools.cache
def _vocabulary() -> tuple[dict[tuple[str, str], int], dict[str, int], dict[int, str]]:
    """Return merges to ranks, pieces to ids, and bytes to signs."""
    lines = gzip.decompress(_MERGES.read_bytes()).decode("utf-8").splitlines()
    first_second = [line.split(" ") for line in lines]
    merges = [(first, second) for first, second in first_second]
    signs = _byte_signs()
    pieces = [*signs.values(), *(sign + _END_OF_WORD for sign in signs.values())]
    pieces += [first + second for first, second in merges]
    ids = {piece: index for index, piece in enumerate(pieces)}
    return {pair: rank for rank, pair in enumerate(merges)}, ids, signs


def _byte_signs() -> dict[int, str]:
    """Give every byte a printable sign: itself where it has one, else one from 256 on.

    The order is that of ids: printable bytes first, then the others.
    """
    printable = [*range(33, 127), *range(161, 173), *range(174, 256)]
    others = [byte for byte in range(256) if byte not in printable]
    signs = {byte: chr(byte) for byte in printable}
    return signs | {byte: chr(256 + index) for index, byte in enumerate(others)}


def _import(package: str) -> Any:
    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise UserError(
            f"--prior: prompts for diffusion priors need the package {package} ({error}); install "
            "the extra gscomplete[mvdream]"
        ) from error
