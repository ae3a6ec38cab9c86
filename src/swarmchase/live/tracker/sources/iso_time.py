"""Times as recordings and records write them: seconds, or ISO 8601."""

import math
from datetime import UTC, datetime
from typing import Any


def time_s(value: Any) -> float:
    """Seconds: a number, or its digits, as it is; ISO 8601, ``2026-03-01T12:00:00.5+01:00``, since 1970, in UTC unless
    it says another zone. NaN for what is none."""
    try:
        return math.nan if isinstance(value, bool) else float(value)
    except OverflowError:
        return math.nan
    except (TypeError, ValueError):
        return _iso_time_s(value)


def _iso_time_s(value: Any) -> float:
    try:
        found = datetime.fromisoformat(str(value).strip())
    except ValueError:
        return math.nan
    return (found if found.tzinfo else found.replace(tzinfo=UTC)).timestamp()
