"""Where training objects come from: the procedural generator and the cuts of the data side."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from gscomplete.priors.embedded.text import build_words
from gscomplete.splats import Splats
from recipes.train_embedded_prior.data.dataset import TrainingObject
from recipes.train_embedded_prior.procedural.captions import vocabulary
from recipes.train_embedded_prior.procedural.objects import FAMILIES, make_object
from splatcomplete_data.cuts.random_cuts import random_partial, slight_partial
from splatcomplete_data.flaws import corrupt

_CAPTIONS_READ = 1000
_FEWEST_CAPTIONS = 5
"""A word of fewer mesh captions is not learned."""


def procedural_source(seed: int, index: int) -> TrainingObject:
    """Make object ``index`` of a seed, with the means to take parts of it."""
    made = make_object(seed, index)

    def partial(*, disturb: bool, slight: bool) -> Splats:
        cut = slight_partial if slight else random_partial
        mask = cut(made.splats, seed, index).mask
        if disturb:
            return corrupt(made.splats, mask, seed, index)
        return made.splats.select(mask)

    return TrainingObject(made.splats, made.caption, partial)


def procedural_words() -> tuple[str, ...]:
    """Return the words to train on: the generator's vocabulary and those of its captions."""
    captions = (make_object(0, index).caption for index in range(_CAPTIONS_READ))
    return tuple(build_words([*vocabulary(), *FAMILIES, *captions]))


def frequent_words(captions: Iterable[str]) -> tuple[str, ...]:
    """Return the words that several captions share, in alphabetical order."""
    counts = Counter(word for caption in captions for word in set(build_words([caption])))
    return tuple(sorted(word for word, count in counts.items() if count >= _FEWEST_CAPTIONS))
