"""Where training objects come from: the procedural generator and the cuts of the data side."""

from __future__ import annotations

from splatcomplete_data.partial import corrupt, random_partial

from gscomplete.splats import Splats
from recipes.train_embedded_prior.dataset import TrainingObject
from recipes.train_embedded_prior.procedural.generator import make_object, vocabulary

_CUTS_PER_OBJECT = 64
"""Spreads the cuts of one object over the index space of ``random_partial``."""


def procedural_source(seed: int, index: int) -> TrainingObject:
    """Make object ``index`` of a seed, with the means to take parts of it."""
    made = make_object(seed, index)

    def partial(ring_number: int, disturb: bool) -> Splats:
        cut_index = index * _CUTS_PER_OBJECT + ring_number
        mask = random_partial(made.splats, seed, cut_index).mask
        if disturb:
            return corrupt(made.splats, mask, seed, cut_index)
        return made.splats.select(mask)

    return TrainingObject(made.splats, made.caption, partial)


def procedural_words() -> list[str]:
    """Return the generator's vocabulary in the order that the embeddings are trained in."""
    return sorted(set(vocabulary()))
