"""The generator's public interface: objects by (seed, index) and the words of their captions."""

from recipes.train_embedded_prior.procedural.captions import vocabulary
from recipes.train_embedded_prior.procedural.objects import (
    FAMILIES,
    ProceduralObject,
    make_object,
    make_object_of,
)

__all__ = [
    "FAMILIES",
    "ProceduralObject",
    "make_object",
    "make_object_of",
    "vocabulary",
]
