"""An interval as a table shows it; apart from the drawing, so that the command line needs no matplotlib for it."""

from collections.abc import Mapping, Sequence
from typing import Any


def shown_interval(interval: Sequence[float] | None, digits: int) -> str:
    """`` [low, high]``; nothing where there is none."""
    return "" if interval is None else f" [{interval[0]:.{digits}f}, {interval[1]:.{digits}f}]"


def shown_share(share: float, interval: Sequence[float] | None, digits: int = 1) -> str:
    """In percent."""
    return f"{100 * share:.{digits}f} %" + shown_interval(interval and [100 * bound for bound in interval], digits)


def shown_reached(row: Mapping[str, Any]) -> str:
    """The share of an evaluation's chases that reached their target."""
    return shown_share(row["success_rate"], row["success_rate_ci95"], 2)


def shown_errors(error_m_after: Mapping[str, float], by_the_clock: bool) -> str:
    """After so many seconds or movements."""
    when = [f"{after}{' s' if by_the_clock else ''}: {error_m:.1f} m" for after, error_m in error_m_after.items()]
    return ", ".join(when)
