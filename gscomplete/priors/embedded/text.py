"""Prompts as the embedded prior reads them: a fixed vocabulary and an honest report.

Conventions
-----------
* Token 0 is padding, token 1 stands for "no text", words follow from 2 in vocabulary order.
* Text is lower-cased and split at everything but letters and digits, so hyphens split too.
* A word is looked up as it is, then by spelling variant, then with simple endings taken off, then
  by synonym.
  A word that is still not found is reported and never used.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from gscomplete.shape.bank.nouns import synonyms_of

PAD_TOKEN = 0
NO_TEXT_TOKEN = 1
FIRST_WORD_TOKEN = 2

STOP_WORDS = frozenset(
    [
        "a",
        "an",
        "the",
        "of",
        "and",
        "with",
        "in",
        "on",
        "at",
        "to",
        "for",
        "from",
        "by",
        "is",
        "are",
        "be",
        "it",
        "its",
        "this",
        "that",
        "these",
        "those",
        "there",
        "some",
        "very",
        "photo",
        "picture",
        "image",
        "render",
        "rendering",
        "object",
        "model",
        "3d",
        "please",
        "my",
        "your",
    ]
)
"""Words that say nothing about the object; ignored unless the vocabulary has them."""

_VARIANTS = {"grey": "gray", "gray": "grey", "jewellery": "jewelry", "colored": "coloured"}
_WORD = re.compile(r"[^\W_]+")
_SHORTEST_STEM = 3
"""Letters; endings say nothing of shorter words: an r is no "red"."""


@dataclass(frozen=True, slots=True)
class PromptReport:
    """How the words of a prompt were taken. Words are in prompt order, as the user wrote them."""

    known: tuple[str, ...]
    unknown: tuple[str, ...]
    ignored: tuple[str, ...]  # stop words
    dropped: tuple[str, ...]  # known, but beyond the longest prompt

    def lines(self) -> tuple[str, ...]:
        """Return the report as sentences for the user."""
        if not self.known:
            first = "prompt: no known word in it, so it does not guide the completion"
        else:
            first = f"prompt: words used: {', '.join(self.known)}"
        lines = [first]
        if self.unknown:
            lines.append(f"prompt: words unknown to this prior: {', '.join(self.unknown)}")
        if self.dropped:
            lines.append(f"prompt: too long; words not used: {', '.join(self.dropped)}")
        return tuple(lines)


class Tokenizer:
    """Turn prompts into token ids over a fixed list of words."""

    def __init__(self, words: Sequence[str], length: int) -> None:
        """Index the vocabulary.

        Args:
            words: lower-case words in the order the embeddings were trained in.
            length: the most tokens a prompt may have.

        Raises:
            ValueError: a word occurs twice.
        """
        self.words = tuple(words)
        self.length = length
        self._ids = {word: FIRST_WORD_TOKEN + index for index, word in enumerate(self.words)}
        if len(self._ids) != len(self.words):
            raise ValueError("Tokenizer: the vocabulary holds a word twice")

    @property
    def size(self) -> int:
        """Number of token ids, padding and no-text included."""
        return FIRST_WORD_TOKEN + len(self.words)

    def lookup(self, word: str) -> int | None:
        """Return the id of a word, of its stem or of a synonym, None when unknown."""
        stems = _stems(word)
        synonyms = [other for stem in stems for other in synonyms_of(stem)]
        for candidate in (*stems, *synonyms):
            if candidate in self._ids:
                return self._ids[candidate]
        return None

    def understood(self, prompt: str) -> PromptReport:
        """Sort the words of a prompt into known, unknown, ignored and dropped."""
        known: list[str] = []
        unknown: list[str] = []
        ignored: list[str] = []
        dropped: list[str] = []
        for word in split_words(prompt):
            if word in STOP_WORDS and word not in self._ids:
                ignored.append(word)
            elif self.lookup(word) is None:
                unknown.append(word)
            else:
                (known if len(known) < self.length else dropped).append(word)
        return PromptReport(tuple(known), tuple(unknown), tuple(ignored), tuple(dropped))

    def encode(self, prompt: str) -> Tensor:  # [length] int64
        """Return token ids padded to ``length``; a prompt without known words is "no text"."""
        ids = [self.lookup(word) for word in self.understood(prompt).known]
        tokens = torch.full((self.length,), PAD_TOKEN, dtype=torch.int64)
        if ids:
            tokens[: len(ids)] = torch.tensor(ids, dtype=torch.int64)
        else:
            tokens[0] = NO_TEXT_TOKEN
        return tokens


def no_text_like(tokens: Tensor) -> Tensor:  # [B, L]
    """Return tokens of the same shape that stand for no text."""
    nothing = torch.full_like(tokens, PAD_TOKEN)
    nothing[:, 0] = NO_TEXT_TOKEN
    return nothing


def understood_by(tokenizers: Sequence[Tokenizer], prompt: str) -> PromptReport:
    """Sort the words of a prompt by what any of some vocabularies knows, the first one's first."""
    reports = [tokenizer.understood(prompt) for tokenizer in tokenizers]
    known = tuple(dict.fromkeys(word for report in reports for word in report.known))
    told = set(known)
    unknown, dropped = (
        tuple(word for word in words if word not in told)
        for words in (reports[0].unknown, reports[0].dropped)
    )
    return PromptReport(known, unknown, reports[0].ignored, dropped)


def split_words(text: str) -> list[str]:
    """Split text into lower-case words of letters and digits, of any script."""
    return _WORD.findall(text.lower())


def build_words(texts: Iterable[str]) -> list[str]:
    """Return the sorted words of some texts without stop words: a vocabulary to train on."""
    return sorted({word for text in texts for word in split_words(text)} - STOP_WORDS)


def _stems(word: str) -> list[str]:
    """List the forms under which a word may be found, the likeliest first."""
    forms = [word]
    if word in _VARIANTS:
        forms.append(_VARIANTS[word])
    for ending, replacements in (
        ("ies", ("y",)),
        ("ves", ("f", "fe")),
        ("es", ("",)),
        ("s", ("",)),
        ("ing", ("", "e")),
        ("ed", ("", "e")),
    ):
        stem = word.removesuffix(ending)
        if (
            len(stem) >= _SHORTEST_STEM
            and stem != word
            and not (ending == "s" and stem.endswith("s"))
        ):
            forms.extend(stem + replacement for replacement in replacements)
    if len(word) >= _SHORTEST_STEM:
        forms.extend((word + "s", word + "en", word + "ed"))
    return forms
