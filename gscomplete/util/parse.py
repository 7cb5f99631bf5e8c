"""Parse options that are given as text with numbers, and check what callers give."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping, Sequence
from typing import Any

from gscomplete.errors import UserError

_SIGNED = re.compile(r"-(\.?\d|[XYZxyz]$)")
"""Begins negative numbers and axes."""
_CONTROLS = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")
"""Moves the cursor, changes colours, ends lines or turns the order of what follows."""


def parse_view(text: str | None, option: str = "--view") -> tuple[float, float] | None:
    """Parse a view as azimuth and elevation in degrees.

    Raises:
        UserError: it has the wrong form, or an angle is out of range.
    """
    numbers = parse_numbers(text, 2, option, "AZIMUTH,ELEVATION")
    if numbers is None:
        return None
    azimuth, elevation = numbers
    if not abs(azimuth) <= 360:
        raise UserError(f"{option}: expected an azimuth of -360 to 360 degrees, found {azimuth:g}")
    if not -90 <= elevation <= 90:
        raise UserError(
            f"{option}: expected an elevation of -90 to 90 degrees, found {elevation:g}"
        )
    return azimuth, elevation


def parse_numbers(text: str | None, count: int, option: str, form: str) -> list[float] | None:
    """Parse comma-separated finite numbers.

    Raises:
        UserError: it has the wrong form.
    """
    if text is None:
        return None
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count or not all(abs(value) < float("inf") for value in values):
        raise UserError(f"{option}: expected {form}, {count} finite numbers, found {text!r}")
    return values


def as_numbers(values: Any) -> tuple[float, ...]:
    """Return a sequence of numbers as a tuple; what is none, such as a text, as an empty one."""
    try:
        if isinstance(values, str) or any(isinstance(value, str) for value in values):
            return ()
        return tuple(map(float, values))
    except (OverflowError, TypeError, ValueError):
        return ()


def shown_numbers(values: Any) -> str:
    """Return a sequence of numbers, or what was found instead of one, for an error message."""
    return ",".join(f"{value:g}" for value in as_numbers(values)) or repr(values)


def require_positive(value: float | None, option: str) -> None:
    """Refuse a length that is not positive and finite; None (not given) passes.

    Raises:
        UserError: it is zero, negative, infinite or NaN, or its inverse is infinite.
    """
    if value is not None and not (0 < value < float("inf") and 1 / value < float("inf")):
        raise UserError(f"{option}: expected a positive length, found {value:g}")


def require_seed(value: int) -> None:
    """Refuse a random seed that not everything which draws with it can hold.

    Raises:
        UserError: it is negative, or has more than 31 bits.
    """
    if not 0 <= value < 2**31:
        raise UserError(f"--seed: expected 0 to {2**31 - 1:,}, found {value}")


def require_text(value: str | None, option: str) -> None:
    """Refuse words for a model that are no Unicode text; None (not given) passes.

    Raises:
        UserError: a byte of it was no UTF-8, or it holds half a surrogate pair.
    """
    if value is not None and not is_text(value):
        raise UserError(f"{option}: expected UTF-8 text, found {value!r}")


def require_prompt(value: str | None, option: str = "--prompt") -> None:
    """Refuse a prompt that says nothing, or not on one line; None (not given) passes.

    Raises:
        UserError: it is empty, no Unicode text, or holds control characters.
    """
    require_text(value, option)
    if value is not None and not value.strip():
        raise UserError(f"{option}: expected a name of the complete object, found an empty text")
    if value is not None and has_controls(value):
        raise UserError(f"{option}: expected a text without control characters, found {value!r}")


def has_controls(value: str) -> bool:
    """Tell whether a text holds characters that terminals obey instead of showing them."""
    return _CONTROLS.search(value) is not None


def shown_text(value: str) -> str:
    r"""Return a text for a terminal: control characters but tabs and line ends as ``\x1b``."""

    def shown(found: re.Match[str]) -> str:
        return found[0] if found[0] in "\t\n" else ascii(found[0])[1:-1]

    return _CONTROLS.sub(shown, value)


def is_text(value: str) -> bool:
    """Tell whether UTF-8 can hold a text: names from the system may have other bytes."""
    return not any("\ud800" <= character <= "\udfff" for character in value)


def with_new_names(arguments: Sequence[str], renamed: Mapping[str, str]) -> list[str]:
    """Replace old names of options by their new ones, with a note on standard error.

    Args:
        arguments: words of a command line.
        renamed: the new name of every old one, both with their dashes.
    """
    result = []
    for word in arguments:
        option, equals, value = word.partition("=")
        if option in renamed:
            sys.stderr.write(
                f"note: {option} is now called {renamed[option]}; the next version drops {option}\n"
            )
        result.append(renamed.get(option, option) + equals + value)
    return result


def with_signs_joined(arguments: Sequence[str]) -> list[str]:
    """Join options to values that begin with a minus, which would be taken for options.

    ``--up -Y`` becomes ``--up=-Y``, and ``--view -30,10`` becomes ``--view=-30,10``.

    Args:
        arguments: words of a command line.
    """
    result: list[str] = []
    for word in arguments:
        is_option = bool(result) and result[-1].startswith("--") and "=" not in result[-1]
        if is_option and _SIGNED.match(word):
            result[-1] += "=" + word
        else:
            result.append(word)
    return result
