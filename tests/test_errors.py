"""The error that reaches a user names what is worked on."""

import pytest

from gscomplete.errors import UserError, naming


class OwnError(UserError):
    """Has an exit code of its own."""

    exit_code = 5


@pytest.mark.parametrize(
    ("message", "told"),
    [
        ("expected splats, found none", "a.ply: expected splats, found none"),
        ("a.ply: expected splats", "a.ply: expected splats"),
        ("--count: expected 1 or more", "--count: expected 1 or more"),
    ],
)
def test_errors_of_a_block_name_what_is_worked_on(message: str, told: str) -> None:
    with pytest.raises(OwnError) as raised, naming("a.ply"):
        raise OwnError(message)
    assert str(raised.value) == told
    assert raised.value.exit_code == 5
