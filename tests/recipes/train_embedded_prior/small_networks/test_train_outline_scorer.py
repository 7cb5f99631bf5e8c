import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from gscomplete.shape.outline.scorer import (
    CAPTURE_OUTLINE_SCORER_FILE,
    FEATURES,
    OUTLINE_SCORER_FILE,
)
from recipes.train_embedded_prior.small_networks.array_sets import joined
from recipes.train_embedded_prior.small_networks.outline_sets import (
    CAPTURE,
    KINDS,
    VIEWS,
    OutlineSets,
)
from recipes.train_embedded_prior.small_networks.train_outline_scorer import (
    WHOLE,
    OutlineScorerConfig,
    fit,
    told,
    weights_of,
)

CONFIG = OutlineScorerConfig(Path("unused"), epochs=40, batch_rows=8, width=16)


def simple_sets(parts: int) -> OutlineSets:
    """One feature tells how whole outlines are."""
    rng = np.random.default_rng(parts)
    features = rng.normal(size=(parts, VIEWS, len(FEATURES))).astype(np.float32)
    shares = np.clip(WHOLE + 0.05 * features[..., 3], 0, 1).astype(np.float32)
    return OutlineSets(features, shares, (np.arange(parts) % 2).astype(np.float32))


def test_a_scorer_learns_which_outlines_are_whole():
    scorer = fit(CONFIG, simple_sets(120))
    sets = simple_sets(20)
    clear = np.abs(sets.shares - WHOLE) > 0.01
    right = (scorer(sets.features) > 0) == (sets.shares >= WHOLE)
    assert right[clear].mean() > 0.95
    assert fit(CONFIG, simple_sets(120)).digest() == scorer.digest()


def test_the_more_an_outline_lacks_the_more_it_counts():
    shares = torch.tensor([1.0, WHOLE, WHOLE - 1e-4, WHOLE - 0.03, WHOLE - 0.3])
    assert weights_of(shares).tolist() == pytest.approx([0.5, 0.5, 0.1, 1.0, 4.0], abs=1e-4)


def test_what_is_told_counts_kinds_apart():
    shares = np.array([[1.0, 0.97, 0.5, 1.0], [0.9, 0.9, 0.9, 0.9]], np.float32)
    features = np.zeros((2, 4, len(FEATURES)), np.float32)
    features[0, :3, 0] = 9  # two of three are wrong, one of which lacks much
    sets = OutlineSets(features, shares, np.array([1, 3], np.float32))
    arcs, halves = told("here", lambda rows: rows[..., 0], sets).splitlines()
    assert arcs.startswith(
        "here, arc, 1: whole outlines of 4 2.0, taken for it 3.0, of these right"
    )
    assert "right 33.3%" in arcs
    assert arcs.endswith("5% 100.0%")
    assert halves.startswith(f"here, {KINDS[3]}, 1: whole outlines of 4 0.0, taken for it 0.0")


def test_few_captures_count_as_often_as_many_parts():
    """40 captures whose outlines are the opposite of 400 parts' make scores less certain."""
    parts, few = simple_sets(400), simple_sets(40)
    opposite = dataclasses.replace(few, shares=2 * np.float32(WHOLE) - few.shares)
    scores = []
    for kind in ("complete", CAPTURE):
        as_kind = dataclasses.replace(opposite, kinds=np.full(40, KINDS.index(kind), np.float32))
        scorer = fit(dataclasses.replace(CONFIG, epochs=12), joined([parts, as_kind]))
        scores.append(np.abs(scorer(parts.features)).mean())
    assert scores[1] < 0.7 * scores[0]


def test_the_scorer_of_captures_has_a_file_of_its_own():
    """Else training it would overwrite the other one."""
    for count, file in ((0, OUTLINE_SCORER_FILE), (96, CAPTURE_OUTLINE_SCORER_FILE)):
        assert dataclasses.replace(CONFIG, captures=count).written_to.name == file
        given = dataclasses.replace(CONFIG, captures=count, out=Path("given"))
        assert given.written_to == Path("given")
