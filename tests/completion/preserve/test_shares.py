"""Which of many amounts count."""

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gscomplete.completion.preserve.shares import enough_of, largest_share


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.floats(0, 1e3, width=32), max_size=40),
    st.floats(0.0, 1.0),
)
def test_the_fewest_amounts_that_are_enough_are_marked(values, share):
    amounts = torch.tensor(values, dtype=torch.float32)
    total = amounts.double().sum()
    for marked, needed in (
        (largest_share(amounts, share), share * total),
        (enough_of(amounts, float(share * total)), share * total),
    ):
        chosen = amounts[marked].double()
        assert float(chosen.sum()) >= float(needed) * (1 - 1e-6)
        if len(chosen):
            assert float(chosen.sum() - chosen.min()) < float(needed) * (1 + 1e-6) + 1e-30
            assert float(chosen.min()) >= float(amounts[~marked].max()) if (~marked).any() else True
