"""What a prompt says the object is: its noun, the noun's forms, and other words for it."""

from __future__ import annotations

import re

_WORD = re.compile(r"[^\W\d_]+")
_BEFORE = frozenset(
    (
        *("with", "of", "in", "on", "for", "from", "that", "which", "by", "at", "without"),
        *("to", "lying", "upside", "seen", "under", "next", "made", "having", "standing"),
    )
)
"""The noun of a prompt comes before the first of these."""
_COLORS = frozenset(
    (
        *("red", "orange", "yellow", "green", "blue", "purple", "pink", "brown", "black", "white"),
        *("grey", "gray", "beige", "gold", "golden", "silver", "turquoise", "teal", "multi"),
    )
)
_ANYTHING = frozenset(
    ("object", "thing", "item", "model", "toy", "figure", "character", "part", "piece", "set")
)
"""Words that tell nothing of a shape."""
_AMOUNTS = frozenset(("pair", "set", "piece", "part", "couple", "half", "rest"))
"""Before "of" these tell how much there is of what follows it."""


def head_noun(prompt: str) -> str | None:
    """Return the word of a prompt that says what the object is; None = there is no such word.

    It is the last word before the first preposition, colours skipped: "a blue mug with a handle" is
    a mug. If there are only colours, it is the last of them: "an orange" is an orange.
    """
    words = _description(prompt)
    plain = [word for word in words if word not in _COLORS] or words
    return plain[-1] if plain and plain[-1] not in _ANYTHING else None


def adjectives_of(prompt: str) -> list[str]:
    """Return the words that describe the noun: "dark" and "red" of "a dark red mug on a table"."""
    words = _description(prompt)
    plain = [k for k, word in enumerate(words) if word not in _COLORS] or range(len(words))
    return words[: plain[-1]] + words[plain[-1] + 1 :] if words else []


def _description(prompt: str) -> list[str]:
    """Return the words up to the first preposition, what tells an amount left out."""
    words = words_of(prompt)
    amount = next((k for k, word in enumerate(words[1:]) if word == "of"), None)
    if amount is not None and words[amount] in _AMOUNTS:
        words = words[amount + 2 :]
    stop = next((k for k, word in enumerate(words) if k and word in _BEFORE), len(words))
    return words[:stop]


def words_of(text: str) -> list[str]:
    """Return the words of a text in lower case, without articles."""
    return [word for word in _WORD.findall(text.lower()) if word not in ("a", "an", "the")]


def forms_of(noun: str) -> frozenset[str]:
    """Return a noun, its singular and its plural."""
    forms = {noun, noun + "s", noun + "es"}
    if noun.endswith("s") and not noun.endswith("ss"):
        forms |= {noun[:-1], noun.removesuffix("es")}
    return frozenset(form for form in forms if len(form) > 1)


_GROUPS = """
sofa couch settee
mug cup teacup
jug pitcher
pan skillet
vase urn
bottle flask
barrel keg cask
box carton
bag sack
backpack rucksack knapsack
bin trashcan dustbin wastebasket
refrigerator fridge
oven stove cooker
bathtub bath tub
sink washbasin basin
toilet lavatory
tap faucet
cabinet cupboard
wardrobe closet
bookcase bookshelf
nightstand bedside
rug carpet
lantern lamp
flashlight torch
television tv
monitor screen display
phone telephone smartphone cellphone
glasses spectacles eyeglasses
shoe sneaker trainer
hat cap
statue sculpture figurine statuette
car automobile auto
truck lorry
motorcycle motorbike
bicycle bike
airplane aeroplane plane aircraft
ship boat
pistol handgun revolver
knife dagger
axe hatchet
rock stone boulder
bush shrub
dog puppy hound
cat kitten
rabbit bunny
hen chicken
donut doughnut
cookie biscuit
"""
_GROUP_OF = {
    word: tuple(other for other in words if other != word)
    for words in (line.split() for line in _GROUPS.split("\n"))
    for word in words
}


def synonyms_of(word: str) -> tuple[str, ...]:
    """Return other words for a thing, in lower case and the singular; most words have none."""
    return _GROUP_OF.get(word, ())
