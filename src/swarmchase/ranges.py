"""What a setting may be, declared beside it, and one refusal for all: its name, the value and what is allowed."""

import dataclasses
import difflib
import math
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from .errors import InputError


@dataclass(frozen=True)
class Range:
    """What a number may be; ``text`` is how the refusal says it."""

    low: float | int = -math.inf
    high: float | int = math.inf
    low_is_allowed: bool = True

    def admits(self, value: float | int) -> bool:
        """Whether it is a finite number in the range."""
        above = value >= self.low if self.low_is_allowed else value > self.low
        # abs() <= max is isfinite() for whole numbers of any size, too.
        return abs(value) <= sys.float_info.max and above and value <= self.high

    @property
    def text(self) -> str:
        """In words."""
        if self.low == -math.inf and self.high == math.inf:
            return "a finite number"
        if self.high == math.inf:
            return f"{'at least' if self.low_is_allowed else 'greater than'} {self.low:.9g}"
        if self.low_is_allowed:
            return f"between {self.low:.9g} and {self.high:.9g}"
        return f"greater than {self.low:.9g} and at most {self.high:.9g}"


FINITE = Range()
POSITIVE = Range(low=0.0, low_is_allowed=False)
AT_LEAST_ZERO = Range(low=0.0)
AT_LEAST_ONE = Range(low=1.0)
SHARE = Range(0.0, 1.0)
SEED = Range(0.0, 2.0**61)
"""Of what PyTorch draws: with what is added to tell one use from another it is still a whole number of 64 bits."""

MOST_SHOWN_CHARACTERS = 200
"""Of a value in a refusal."""

Allowed = Range | Sequence[str]
"""A range of numbers, or the words to choose from."""


def ranged(default: Any, allowed: Allowed) -> Any:
    """A field of a dataclass with what it may be; ``require_ranges`` holds it to that."""
    return field(default=default, metadata={"allowed": allowed})


def require_ranges(settings: Any) -> None:
    """Check every field of a dataclass that says what it may be; None is "not given" and always allowed.

    Raises:
        InputError: a value that is not allowed; a field whose default is a whole number must be one.
    """
    for setting in dataclasses.fields(settings):
        allowed, value = setting.metadata.get("allowed"), getattr(settings, setting.name)
        if allowed is None or value is None:
            continue
        if isinstance(allowed, Range):
            checked_number(setting.name, value, allowed, whole=isinstance(setting.default, int))
        else:
            require_choice(setting.name, value, allowed)


def checked_number(name: str, value: Any, allowed: Range, whole: bool = False) -> float | int:
    """The number as a float, or as an int where it is to be ``whole``.

    Raises:
        InputError: no number, or one that is not allowed.
    """
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not allowed.admits(value) or (whole and int(value) != value):
        raise InputError(
            f"{name} = {shown(value)} is refused: allowed is {'a whole number ' if whole else ''}{allowed.text}"
        )
    return int(value) if whole else float(value)


def require_choice(name: str, value: Any, allowed: Sequence[str]) -> None:
    """Refuse what is not one of these words.

    Raises:
        InputError: it is not.
    """
    if value not in allowed:
        raise InputError(f"{name} = {shown(value)} is refused: allowed is {' or '.join(map(repr, allowed))}")


def meant(word: str, known: Iterable[str]) -> str:
    """What was probably meant by a word that is not known, in brackets; nothing where none is alike."""
    alike = difflib.get_close_matches(word, list(known), n=1)
    return f" (did you mean {alike[0]}?)" if alike else ""


def shown(value: Any) -> str:
    """A refused value in a line that people read, whatever its length."""
    try:
        text = repr(value)
    except ValueError:  # Python writes no number of thousands of digits
        text = "a number of too many digits"
    return text if len(text) <= MOST_SHOWN_CHARACTERS else f"{text[:MOST_SHOWN_CHARACTERS]}..."
