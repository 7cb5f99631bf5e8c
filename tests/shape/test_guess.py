import pytest
import torch

from gscomplete.priors import load_prior
from gscomplete.priors.embedded.prior import packaged_weights
from gscomplete.shape.bank.store import BANK_FILE, read_bank
from gscomplete.shape.guess import Asked, KnownShapes, guess_complete
from gscomplete.shape.predict import voices_that_count
from gscomplete.splats import Splats
from gscomplete.views import ViewDistribution
from tests.builders.known_shapes import cell_points
from tests.builders.objects import round_splats

BANK = packaged_weights() / BANK_FILE
VIEWS = ViewDistribution(0.0, 15.0)


@pytest.fixture(scope="module")
def asked():
    prior = load_prior("embedded")
    words = prior.condition("a chair").tokens
    nothing = prior.condition("").tokens
    return Asked(prior._shape, words, nothing, bfloat16=False, ends_in_plane=False)


def seat_and_back() -> Splats:
    """Return what is above the legs of a known chair, in the frame that its box suggests."""
    bank = read_bank(BANK)
    chair = next(k for k, name in enumerate(bank.names) if name.id == "quaternius/chair_1")
    points = cell_points(bank.surface(chair))
    upper = points[points[:, 2] > 0.0]
    low, high = upper.min(axis=0), upper.max(axis=0)
    placed = (upper - (low + high) / 2) / (high - low).max()
    return round_splats(torch.from_numpy(placed).float(), scale=0.014)


def guess(asked, prompt, bank=BANK):
    generator = torch.Generator().manual_seed(0)
    known = KnownShapes(bank, prompt)
    return guess_complete(asked, seat_and_back(), VIEWS, "none", known, 4000, generator)


def test_known_chairs_give_the_legs_that_p_has_not(asked):
    found = guess(asked, "a wooden chair")
    bottom = float(seat_and_back().means[:, 2].min())
    assert len(found.known) >= 2
    assert len({shape.name.pack for shape in found.known}) == len(found.known)
    legs = found.splats.means[found.splats.means[:, 2] < bottom - 0.1]
    assert len(legs) > 300
    assert torch.isfinite(found.splats.means).all()
    known = torch.from_numpy(found.known[0].points).float()
    # cells of the grid are .03 of the wider frame
    assert float(torch.cdist(legs, known).amin(dim=1).quantile(0.9)) < 0.15
    assert "known shapes" in found.notes[0]


def test_without_known_shapes_they_change_nothing(asked):
    plain = guess(asked, "a wooden chair", bank=None)
    assert plain.known == ()
    assert not any("known shape" in note for note in plain.notes)
    other = guess(asked, "a wooden unicorn")
    assert other.notes[0] == "unicorn: no known shape is called so"
    for (_, one), (_, two) in zip(other.splats.fields(), plain.splats.fields(), strict=True):
        assert torch.equal(one, two)


def test_answers_count_that_agree_and_more_than_with_the_plain_one():
    def filled(share):
        return torch.where(torch.arange(20) < 20 * share, 1.0, -1.0)

    def voices(shown, plain, **options):
        found = voices_that_count([filled(s) for s in shown], filled(plain), **options)
        return [float((voice > 0).float().mean()) for voice in found]

    assert voices([1.0, 0.9], 0.6) == [pytest.approx(s) for s in (0.6, 1.0, 0.9)]
    assert voices([1.0, 0.9], 0.6, shapes_alone=True) == [pytest.approx(s) for s in (1.0, 0.9)]
    assert voices([1.0, 0.9], 0.2) == [pytest.approx(s) for s in (1.0, 0.9)]  # plain is far off
    assert voices([1.0, 0.9], 0.95) == []  # nothing new
    assert voices([1.0, 0.3], 0.1) == []  # no agreement
