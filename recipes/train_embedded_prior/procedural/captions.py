"""Short captions of procedural objects, and every word they can use.

Captions follow the manner of hand-written ones ("a blue ceramic mug with white stripes"): leading
words (size, colour, substance, style), a name, and perhaps one or two details after "with".
"""

from __future__ import annotations

import numpy as np

from recipes.train_embedded_prior.procedural.assembly import PATTERN_WORDS, Description, Look
from recipes.train_embedded_prior.procedural.palette import COLORS, SUBSTANCES
from recipes.train_embedded_prior.procedural.words import name_words

SIZES = ("small", "large", "big", "little", "tiny")
STYLES = ("simple", "toy", "low-poly", "old", "new", "single", "pretty", "model")
SYNONYMS = {
    "grey": ("grey", "gray"),
    "light grey": ("light grey", "light gray"),
    "dark grey": ("dark grey", "dark gray"),
    "golden": ("golden", "gold"),
    "dark blue": ("dark blue", "navy blue"),
    "dark red": ("dark red", "maroon"),
    "light brown": ("light brown", "tan"),
    "turquoise": ("turquoise", "cyan"),
    "purple": ("purple", "violet"),
    "plush": ("plush", "stuffed", "soft"),
    "fabric": ("fabric", "upholstered", "cloth"),
    "metal": ("metal", "metallic", "steel"),
    "wooden": ("wooden", "wood"),
    "leafy": ("leafy",),
    "clay": ("clay", "terracotta"),
}
PATTERN_ADJECTIVES = {
    "stripes": "striped",
    "bands": "striped",
    "diagonal": "striped",
    "checks": "checkered",
    "dots": "dotted",
    "patches": "spotted",
}
FRAMES = ("a {}", "a {}", "a {}", "{}", "the {}", "one {}")


def caption(description: Description, rng: np.random.Generator) -> str:
    """Write a caption; colours are named nine times out of ten."""
    look = description.look
    noun = _choose(description.nouns, rng)
    lead = [_choose(description.adjectives, rng)] if description.adjectives else []
    lead = lead if rng.random() < 0.4 else []
    if rng.random() < 0.12:
        lead.insert(0, _choose(SIZES, rng))
    if rng.random() < 0.08:
        lead.append(_choose(STYLES, rng))
    color, details = _color_words(look, rng)
    colored = color is not None and rng.random() < 0.92
    substance = []
    if look.substance not in ("plain", look.color) and rng.random() < 0.5:
        substance = [_synonym(look.substance, rng)]
    if rng.random() < 0.7 and description.details:
        order = rng.permutation(len(description.details))[: 1 if rng.random() < 0.7 else 2]
        for phrase in (description.details[k] for k in order):
            if not details or phrase.split()[-1] != details[-1].split()[-1]:
                details.append(phrase)
    trailing = rng.random() >= 0.85 and colored
    before = [color] if color is not None and colored and not trailing else []
    words = [*lead, *before, *substance, noun]
    if before and lead and rng.random() < 0.3:
        words = [*before, *lead, *substance, noun]
    text = _choose(FRAMES, rng).format(" ".join(words))
    text += f" in {color}" if trailing else ""
    text += f" with {' and '.join(details)}" if details else ""
    return with_article(text)


def with_article(text: str) -> str:
    """Turn "a" into "an" before a vowel, anywhere in the text."""
    words = text.split()
    for k in range(len(words) - 1):
        if words[k] == "a" and words[k + 1][0] in "aeiou":
            words[k] = "an"
    return " ".join(words)


def detail(look: Look, part: str, *, plural: bool = False) -> str:
    """Say a part with its colour: "a brown lid", "black wheels"."""
    return f"{look.color} {part}" if plural else f"a {look.color} {part}"


def vocabulary() -> list[str]:
    """Return, sorted, every word that a caption can contain, and the further words of ``words``."""
    words = {"a", "an", "the", "one", "with", "and", "in"} | name_words()
    phrases = [*SIZES, *STYLES, *COLORS, *SUBSTANCES, *PATTERN_ADJECTIVES.values()]
    phrases += [word for options in SYNONYMS.values() for word in options]
    phrases += [word for options in PATTERN_WORDS.values() for word in options]
    for phrase in phrases:
        words.update(phrase.split())
    return sorted(words)


def _choose(options: tuple[str, ...], rng: np.random.Generator) -> str:
    """Draw one of several strings."""
    return options[int(rng.integers(len(options)))]


def _synonym(word: str, rng: np.random.Generator) -> str:
    """Replace a word by one that means the same, in a third of all cases."""
    return _choose(SYNONYMS[word], rng) if word in SYNONYMS and rng.random() < 0.35 else word


def _color_words(look: Look, rng: np.random.Generator) -> tuple[str | None, list[str]]:
    """Return the colour phrase and the pattern phrase (as a list of details)."""
    first = _synonym(look.color, rng)
    pattern = look.material.pattern
    if look.accent is None or pattern not in PATTERN_WORDS:
        return first, []
    second = _synonym(look.accent, rng)
    if rng.random() < 0.4:
        adjective = PATTERN_ADJECTIVES.get(pattern)
        joined = f"{first} and {second}"
        return (f"{joined} {adjective}" if adjective and rng.random() < 0.6 else joined), []
    words = _choose(PATTERN_WORDS[pattern], rng)
    if words.startswith("a "):
        return first, [f"a {second} {words[2:]}"]
    return first, [f"{second} {words}"]
