import re
import time
from pathlib import Path

import numpy as np
import pytest
import torch

from recipes.train_embedded_prior.procedural import objects
from recipes.train_embedded_prior.procedural.captions import vocabulary, with_article
from recipes.train_embedded_prior.procedural.objects import (
    ABSTRACT,
    ABSTRACT_SHARE,
    CONCRETE,
    FAMILIES,
    family_of,
    into_unit_box,
    make_object,
    make_object_of,
)

MANIFEST = Path(__file__).resolve().parents[4] / "../shared/data/MANIFEST.tsv"
WORDS = frozenset(vocabulary())


@pytest.mark.parametrize("family", FAMILIES)
def test_every_family_makes_valid_objects(family):
    for index in range(6):
        made = make_object_of(family, 11, index)
        splats = made.splats
        assert made.family == family
        assert all(value.dtype == torch.float32 for _, value in splats.fields())
        assert all(torch.isfinite(value).all() for _, value in splats.fields())
        assert torch.allclose(splats.quaternions.norm(dim=1), torch.ones(len(splats)), atol=1e-4)
        assert splats.scales.min() > 0
        assert splats.scales.max() < 0.1
        assert 0.94 < splats.opacities.min() <= splats.opacities.max() < 1
        assert -1e-4 <= splats.base_colors.min() <= splats.base_colors.max() <= 1 + 1e-4
        low, high = splats.bounds()
        assert (high - low).max() == pytest.approx(1.0, abs=1e-4)
        assert torch.allclose(low + high, torch.zeros(3), atol=1e-4)
        assert set(made.caption.split()) <= WORDS, made.caption


def test_objects_are_functions_of_seed_and_index():
    for index in (0, 7, 12345):
        first, second = make_object(5, index), make_object(5, index)
        named = make_object_of(first.family, 5, index)
        for (name, a), (_, b), (_, c) in zip(
            first.splats.fields(), second.splats.fields(), named.splats.fields(), strict=True
        ):
            assert torch.equal(a, b), name
            assert torch.equal(a, c), name
        assert first.caption == second.caption == named.caption
    assert make_object(5, 0).caption != make_object(6, 0).caption


def test_the_stream_holds_its_shares_and_every_family():
    drawn = [family_of(1, index) for index in range(3000)]
    assert set(drawn) == set(FAMILIES)
    share = np.mean([name in ABSTRACT for name in drawn])
    error = (ABSTRACT_SHARE * (1 - ABSTRACT_SHARE) / len(drawn)) ** 0.5  # standard error
    assert share == pytest.approx(ABSTRACT_SHARE, abs=2 * error)
    assert len(CONCRETE) >= 40


def test_splat_counts_are_within_their_range(monkeypatch):
    monkeypatch.setattr(objects, "_SPLATS", (500, 600))
    counts = [len(make_object(2, index).splats) for index in range(10)]
    assert min(counts) >= 500
    assert max(counts) <= 600


def test_unknown_families_are_refused():
    with pytest.raises(KeyError):
        make_object_of("perpetuum mobile", 0, 0)


def test_unit_boxes():
    points = np.array([[0, 0, 0], [2, 4, 1]], np.float32)
    moved, scale = into_unit_box(points)
    assert scale == pytest.approx(0.25)
    assert np.allclose(moved, [[-0.25, -0.5, -0.125], [0.25, 0.5, 0.125]])


def test_captions_are_short_and_varied(monkeypatch):
    monkeypatch.setattr(objects, "_SPLATS", (100, 120))
    captions = [make_object(8, index).caption for index in range(300)]
    assert len(set(captions)) > 280
    assert max(len(text.split()) for text in captions) <= 22
    assert not any(re.search(r"\ba [aeiou]|  |\bNone\b", text) for text in captions)


def test_articles():
    assert with_article("a orange mug with a olive lid") == "an orange mug with an olive lid"


def test_the_vocabulary_is_sorted_unique_and_plain():
    words = vocabulary()
    assert words == sorted(set(words))
    assert all(re.fullmatch(r"[a-z]+(-[a-z]+)*", word) for word in words)


def test_real_captions_are_mostly_covered():
    if not MANIFEST.exists():
        pytest.skip("shared/data is absent")
    rows = [line.split("\t") for line in MANIFEST.read_text().splitlines()[1:]]
    words = [w for row in rows if row[1] == "mesh" for w in re.findall(r"[a-z-]+", row[3].lower())]
    assert np.mean([word in WORDS for word in words]) > 0.97


def test_an_object_takes_milliseconds():
    make_object(0, 0)
    start = time.process_time()
    for index in range(40):
        make_object(9, index)
    assert (time.process_time() - start) / 40 < 0.04  # 4 to 7 ms alone; slack for a busy machine
