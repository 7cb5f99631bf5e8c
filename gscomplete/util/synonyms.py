"""Words for the same kind of thing, so that a prompt's word finds what goes by another one."""

from __future__ import annotations

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
sword blade
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
