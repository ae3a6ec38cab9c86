"""A basis of Clarke's (Jakes') Doppler spectrum, the same on every processor."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

DISCARDED_POWER = 1e-9
"""Share of the scattered power that the truncated eigendecomposition may leave out (its error in any covariance)."""

SIGNS = {
    (50, 10.0, 1.0): "--+-+-+-+--------+",
    (50, 20.0, 1.0): "++--++--+-+-",
    (50, 50.0, 1.0): "-+++--+-",
    (50, 100.0, 1.0): "++----",
    (50, 10.0, 0.5): "++--++--+-+-",
    (50, 10.0, 5.0): "++-+-+-++-+-+-+--++--++-+-++--+-++-+++-+---+++-+++",
    (50, 100.0, 0.5): "+----",
    (50, 100.0, 5.0): "++--++--+++-",
}
"""By the number of samples, the sampling frequency and the Doppler spread: on which side of 0 each eigenvector begins.

Any signs give the same law but other draws, and eigensolvers choose them by the processor that they run on. The
published tables of these worlds were drawn with these; in all other worlds eigenvectors begin above 0.
"""


def jakes_basis(num_samples: int, sampling_hz: float, doppler_spread_hz: float) -> "NDArray[np.float64]":
    """B [rank, sample] such that w B, w of CN(0, 1), has the covariance J0(2 pi f_d tau) of Clarke's model.

    The Toeplitz matrix is numerically singular (its condition passes 1e15), so Cholesky fails; the eigenvectors
    that hold all but ``DISCARDED_POWER`` of the power are exact to that figure. Each of the two parts of w has
    variance 1/2, which is folded into B: feed standard normals for both.
    """
    from scipy.linalg import eigh, toeplitz
    from scipy.special import j0

    sample_time_s = np.arange(num_samples) / sampling_hz
    eigenvalue, eigenvector = eigh(toeplitz(j0(2 * np.pi * doppler_spread_hz * sample_time_s)))
    kept = eigenvalue > DISCARDED_POWER * eigenvalue.sum()
    vector = eigenvector[:, kept]
    signs = _signs(SIGNS.get((num_samples, sampling_hz, doppler_spread_hz), ""), vector.shape[1])
    return np.asarray((vector * (signs * np.sign(vector[0])) * np.sqrt(eigenvalue[kept] / 2)).T)


def _signs(told: str, rank: int) -> "NDArray[np.float64]":
    """Counted from the last eigenvector, which holds most power: rounding may decide whether the first is kept."""
    return np.array([-1.0 if sign == "-" else 1.0 for sign in told.rjust(rank, "+")[-rank:]])
