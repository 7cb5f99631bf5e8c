import numpy as np
import torch

from gscomplete.shape.evidence import Evidence, gather_evidence
from gscomplete.shape.n_fold_copies import n_fold_copies
from gscomplete.splats import Splats
from gscomplete.splats.geometry.n_fold import NFold, find_n_fold
from gscomplete.views import ViewDistribution
from tests.builders.objects import round_splats
from tests.builders.vases import HEIGHT, faceted, vase

DOWN = np.array([0.0, 0.0, HEIGHT / 2])


def part_of(azimuths_deg: tuple[float, float]) -> tuple[Splats, NFold]:
    points = faceted(vase(azimuths_deg=azimuths_deg), 8) - DOWN
    fold = find_n_fold(points)
    assert fold is not None
    return round_splats(torch.from_numpy(points).float(), scale=0.008), fold


def evidence_of(partial: Splats, azimuth_deg: float) -> Evidence:
    return gather_evidence(partial, ViewDistribution(azimuth_deg, 10.0))


def test_copies_lie_on_the_rest_of_the_surface():
    partial, fold = part_of((-100.0, 100.0))
    copies = n_fold_copies(partial, fold, evidence_of(partial, 0.0), torch.Generator())
    assert copies is not None
    places = copies.means.double().numpy()
    whole = faceted(vase(40_000), 8) - DOWN
    distance = np.linalg.norm(places[::20, None] - whole[None, ::4], axis=2).min(axis=1)
    assert distance.max() < 0.03  # of ten thousand points on the wall
    azimuth_deg = np.degrees(np.arctan2(places[:, 1], places[:, 0])) % 360
    assert set(np.floor(azimuth_deg / 20).astype(int)) >= set(range(6, 12))
    # in gaps between P's points, which are drawn at random; measured: .020
    assert (np.abs((azimuth_deg + 180) % 360 - 180) < 90).mean() < 0.03


def test_a_whole_thing_lacks_none():
    partial, fold = part_of((0.0, 360.0))
    assert n_fold_copies(partial, fold, evidence_of(partial, 0.0), torch.Generator()) is None


def test_what_views_saw_through_is_not_filled():
    """From the open side views see the inner wall, in front of which nothing is."""
    partial, fold = part_of((-100.0, 100.0))
    seen = evidence_of(partial, 180.0)
    assert n_fold_copies(partial, fold, seen, torch.Generator()) is None
