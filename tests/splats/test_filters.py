"""Which splats can be drawn."""

import torch

from gscomplete.splats.filters import usable_rows
from gscomplete.splats.record import Splats


def test_each_reason_is_counted_once():
    splats = Splats(
        torch.zeros(7, 3), torch.ones(7, 4), torch.ones(7, 3), torch.ones(7), torch.zeros(7, 1, 3)
    )
    splats.means[1, 2] = float("nan")
    splats.sh[1] = float("nan")
    splats.quaternions[2] = float("nan")
    splats.scales[3, 0] = float("inf")
    splats.opacities[4] = float("nan")
    splats.means[5] = -1e30
    keep, counts = usable_rows(splats)
    assert keep.tolist() == [True, False, False, False, False, False, True]
    assert sum(counts.values()) == 5
    assert counts["non_finite_mean"] == counts["too_large"] == 1
    assert "non_finite_sh" not in counts


def test_no_splats():
    empty = Splats(*(torch.zeros(0, *s) for s in [(3,), (4,), (3,), (), (1, 3)]))
    keep, counts = usable_rows(empty)
    assert (len(keep), counts) == (0, {})
