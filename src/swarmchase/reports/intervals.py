"""An interval as a table shows it; apart from the drawing, so that the command line needs no matplotlib for it."""

from collections.abc import Sequence


def shown_interval(interval: Sequence[float] | None, digits: int) -> str:
    """`` [low, high]``; nothing where there is none."""
    return "" if interval is None else f" [{interval[0]:.{digits}f}, {interval[1]:.{digits}f}]"


def shown_share(share: float, interval: Sequence[float]) -> str:
    """In percent."""
    return f"{100 * share:.1f} %" + shown_interval([100 * bound for bound in interval], 1)
