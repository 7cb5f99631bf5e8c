"""The one error type that reaches a user as a message instead of a traceback."""

import contextlib
from collections.abc import Iterator


class UserError(Exception):
    """Something in the user's input, options or machine is wrong, and the message says what.

    A message names the file or option, the field, what was expected and what was found.
    The command line prints it and exits with ``exit_code``; library callers may catch it.
    """

    exit_code = 2


@contextlib.contextmanager
def naming(source: object) -> Iterator[None]:
    """Have errors of the block name what is worked on, where they name neither it nor an option.

    Args:
        source: the file or folder, as the user named it.

    Raises:
        UserError: the block raises one; it begins with the source or with an option.
    """
    try:
        yield
    except UserError as error:
        if str(error).startswith((str(source), "--")):
            raise
        raise type(error)(f"{source}: {error}") from error
