"""The one error type that reaches a user as a message instead of a traceback."""


class UserError(Exception):
    """Something in the user's input, options or machine is wrong, and the message says what.

    A message names the file or option, the field, what was expected and what was found.
    The command line prints it and exits with ``exit_code``; library callers may catch it.
    """

    exit_code = 2
