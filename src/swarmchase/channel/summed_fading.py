"""How the power of a sample is spread about its mean where one transmitter is heard, and where those of two add up.

Of one it is the square of a Rician amplitude (Eqs. 3-5): once in a while nearly nothing arrives. Of two that fade
independently that is rare, since the weaker one fills the deep fades of the stronger.
"""

import functools
import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import i0e

Powers = NDArray[np.float64]

LEAST_NP, MOST_NP, STEP_NP = -9.0, 3.0, 0.1
"""Range and resolution, in nepers of power over the mean of the stronger transmitter's."""
MOST_POWER = 7.0
"""In its own mean; only without line of sight one sample in 1000 has more."""
NODES = 48
"""Of the sum over what the weaker one adds (Gauss and Legendre)."""
LEAST_DENSITY = 1e-30


def power_density(power: Powers, rician_k: float) -> Powers:
    """Of one transmitter's power, in its mean."""
    reach = 2 * np.sqrt(rician_k * (rician_k + 1) * np.maximum(power, 0.0))
    density = (rician_k + 1) * np.exp(reach - rician_k - (rician_k + 1) * power) * i0e(reach)
    return np.where(power >= 0, density, 0.0)


@functools.lru_cache(maxsize=256)
def log_density(rician_k: float, weaker: float) -> Powers:
    """The logarithm of the density of a sample's power in nepers, level by level from ``LEAST_NP`` on.

    Args:
        rician_k: of both.
        weaker: the mean power of the weaker one, in that of the stronger; 0: there is none.
    """
    power = np.exp(LEAST_NP + STEP_NP * np.arange(num_levels()))
    if weaker == 0:
        density = power_density(power, rician_k)
    else:
        nodes, weights = np.polynomial.legendre.leggauss(NODES)
        least, most = np.maximum(power - MOST_POWER, 0.0) / weaker, np.minimum(power / weaker, MOST_POWER)
        added = least[:, None] + (most - least)[:, None] * (nodes + 1) / 2
        both = power_density(power[:, None] - weaker * added, rician_k) * power_density(added, rician_k)
        density = (both @ weights) * (most - least) / 2
    return np.asarray(np.log(np.maximum(density * power, LEAST_DENSITY)))


def num_levels() -> int:
    """Of the table."""
    return math.ceil((MOST_NP - LEAST_NP) / STEP_NP) + 1
