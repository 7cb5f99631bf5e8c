from pathlib import Path
from types import SimpleNamespace

import pytest

from gscomplete.commands.complete import CompleteOptions, _request
from gscomplete.errors import UserError


@pytest.mark.parametrize("mirror", ["none", "30,0.1"])
def test_a_plane_is_refused_where_the_prior_cannot_guess_the_whole(mirror):
    """``reconstruct`` starts from a guess, but only if the prior has one."""
    options = CompleteOptions(
        partial=Path("half.ply"), prompt="a mug", preset="reconstruct", mirror=mirror
    )
    with pytest.raises(UserError, match="preset reconstruct with prior known starts without"):
        _request(options, SimpleNamespace(name="known"))
