"""Make the sample of ``make demo``: ``python -m recipes.demo.make_sample``.

The object comes from the procedural generator with a fixed seed that training never uses; a plane
through it, seen from the front, takes away its back half.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch

from gscomplete.splats import Splats, write_splats
from gscomplete.util.atomic import atomic_path
from recipes.train_embedded_prior.procedural.objects import make_object_of

FOLDER = Path(__file__).resolve().parent
FAMILY = "mug"
SEED = 20_261_121
INDEX = 4
CUT_AXIS = 0
"""Object-frame axis along which the half with negative coordinates is removed."""


def sample() -> tuple[Splats, str]:
    """Return the partial object and its prompt."""
    made = make_object_of(FAMILY, SEED, INDEX)
    kept = made.splats.means[:, CUT_AXIS] > 0.0
    return made.splats.select(torch.as_tensor(kept)), made.caption


def main() -> None:
    """Write ``partial.ply`` and ``prompt.txt`` beside this file."""
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    partial, prompt = sample()
    write_splats(FOLDER / "partial.ply", partial, ("made by recipes.demo.make_sample",))
    with atomic_path(FOLDER / "prompt.txt") as temporary:
        temporary.write_text(prompt + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
