"""Ways and velocities that are too long, made as long as they may be."""

import numpy as np

from .sample_window import Point, Points

LEAST = 1e-9
"""Nothing is divided by less."""


def shortened(vector: Point, longest: float) -> Point:
    """In the same direction, and no longer than this."""
    return np.asarray(vector * min(1.0, longest / max(float(np.linalg.norm(vector)), LEAST)))


def shortened_each(vectors: Points, longest: float) -> Points:
    """The same for each tracker's [tracker, 3]."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors * np.minimum(1.0, longest / np.maximum(length, LEAST)))
