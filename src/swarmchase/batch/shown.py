"""What batches look like in a line of text."""

from .array_types import Tensor


def shown_chases(number: int) -> str:
    """``1 chase``, ``2 chases``."""
    return f"{number} chase{'s' if number != 1 else ''}"


def shown_range(values: Tensor) -> str:
    """From the least to the greatest in three digits; a dash where there is none."""
    if values.numel() == 0:
        return "-"
    low, high = f"{values.min():.3g}", f"{values.max():.3g}"
    return low if low == high else f"{low} to {high}"
