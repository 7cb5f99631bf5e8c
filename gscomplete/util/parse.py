"""Parse options that are given as text with numbers."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence

from gscomplete.errors import UserError


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


def require_positive(value: float | None, option: str) -> None:
    """Refuse a length that is not positive and finite; None (not given) passes.

    Raises:
        UserError: it is zero, negative, infinite or NaN.
    """
    if value is not None and not 0 < value < float("inf"):
        raise UserError(f"{option}: expected a positive length, found {value:g}")


def require_text(value: str | None, option: str) -> None:
    """Refuse words for a model that are no Unicode text; None (not given) passes.

    Raises:
        UserError: a byte of it was no UTF-8, or it holds half a surrogate pair.
    """
    if value is not None and not is_text(value):
        raise UserError(f"{option}: expected UTF-8 text, found {value!r}")


def require_prompt(value: str | None, option: str = "--prompt") -> None:
    """Refuse a prompt that says nothing; None (not given) passes.

    Raises:
        UserError: it is empty, or no Unicode text.
    """
    require_text(value, option)
    if value is not None and not value.strip():
        raise UserError(f"{option}: expected a name of the complete object, found an empty text")


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
