"""Colours that a depth camera mixes at edges do not reach the guess, and true ones do."""

import dataclasses

import numpy as np
import pytest
import torch

from gscomplete.completion.alternatives import guess_alternatives
from gscomplete.completion.settings import CompletionSettings
from gscomplete.completion.start import start_splats
from gscomplete.priors.base import FirstGuess
from gscomplete.shape.colors.edges import without_mixed_edges
from gscomplete.splats import Splats, colors_to_sh
from gscomplete.views import ViewDistribution
from tests.builders.objects import round_splats
from tests.builders.priors import GuessingPrior

MIXED = CompletionSettings(mixed_edge_colors=True)
SIDE = 60
BLUE, TABLE = (0.2, 0.3, 0.9), (0.35, 0.3, 0.25)


def sheet(border: int = 1) -> tuple[Splats, torch.Tensor]:
    """A square of splats, blue but for a border of so many rows in the table's colour."""
    at = np.linspace(-0.5, 0.5, SIDE)
    x, y = (a.ravel() for a in np.meshgrid(at, at))
    outermost = np.maximum(abs(x), abs(y)) > 0.5 - (border - 0.5) / (SIDE - 1)
    on_border = torch.from_numpy(outermost)
    colors = torch.where(on_border[:, None], torch.tensor(TABLE), torch.tensor(BLUE))
    wobble = torch.randn(len(x), 3, generator=torch.Generator().manual_seed(0)) * 0.01
    means = np.stack([x, y, np.zeros_like(x)], axis=1) + 1e-4 * wobble.numpy()
    return round_splats(means, scale=0.01, color=colors + wobble), on_border


def test_a_mixed_border_takes_the_colours_further_inside():
    splats, on_border = sheet()
    seen, count = without_mixed_edges(splats)
    assert count == int(on_border.sum())
    off = (seen.base_colors - torch.tensor(BLUE)).abs().amax(dim=1)
    assert float(off.max()) < 0.05  # the wobble's four standard deviations
    for (name, own), (_, other) in zip(seen.fields(), splats.fields(), strict=True):
        assert name == "sh" or torch.equal(own, other), name
    assert torch.equal(seen.sh[~on_border], splats.sh[~on_border])


def test_edges_like_their_inside_keep_their_colours():
    plain, _ = sheet(border=0)
    seen, count = without_mixed_edges(plain)
    assert count == 0
    assert torch.equal(seen.sh, plain.sh)
    x = plain.means[:, 0]
    is_blue = (x * 30).floor()[:, None] % 2 > 0
    striped = torch.where(is_blue, torch.tensor(BLUE), torch.tensor(TABLE))
    stripes = dataclasses.replace(plain, sh=colors_to_sh(striped))  # as varied within as at edges
    _, count = without_mixed_edges(stripes)
    assert count < 0.01 * len(stripes)


@pytest.mark.parametrize("count", [0, 1, 99, 150])
def test_few_splats_and_splats_in_one_place_are_no_error(count):
    splats, _ = sheet()
    few = splats.select(torch.arange(count))
    assert len(without_mixed_edges(few)[0]) == count
    one_place = dataclasses.replace(splats, means=torch.zeros_like(splats.means))
    assert without_mixed_edges(one_place)[1] == 0


def test_the_prior_guesses_from_these_colours_and_the_note_counts_them():
    splats, on_border = sheet()
    given = []

    class Watching(GuessingPrior):
        def first_guess(self, partial, *more, **options):
            given.append(partial)
            return super().first_guess(partial, *more, **options)

    prior = Watching(splats, FirstGuess(splats.select(torch.arange(5)), ()))
    views = ViewDistribution(0.0, 10.0)
    settings = dataclasses.replace(MIXED, start="guess")
    start = start_splats(splats, prior, prior.condition("a sheet"), views, settings)
    assert f"{int(on_border.sum())} splats at P's edges are unlike" in start.note
    prior.likely_mirrors = lambda partial, *_: given.append(partial) or ("none",)
    guess_alternatives(prior, splats, views, prior.condition("a sheet"), settings, 1)
    assert len(given) == 3  # for the run, for the planes, and for the alternative
    expected = without_mixed_edges(splats)[0].base_colors
    assert all(torch.equal(seen.base_colors, expected) for seen in given)
