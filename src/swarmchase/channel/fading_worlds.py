"""Windows of many fadings at once, for training: each world has its own K, Doppler spread and correlation.

The law is that of ``drawn_windows``: Rician, Jakes Doppler, correlated over the trackers (Eqs. 3-5). Here all worlds
are drawn together on one device, by the square root of each window's covariance in time.
"""

import math
from dataclasses import dataclass

import torch

from ..batch.array_types import Float, Tensor
from ..scenario import NUM_TRACKERS
from .fading import DEEPEST_FADE_DB

SLOWEST, FASTEST = 5e-4, 1.0
"""Doppler spread over sampling frequency."""
NUM_SPEEDS = 200
"""Between them, evenly in the logarithm."""


@dataclass(frozen=True)
class FadingWorlds:
    """The fading of each world."""

    doppler_per_sample: Float[Tensor, "world"]
    """Doppler spread over sampling frequency."""
    rician_k: Float[Tensor, "world"]
    spatial_correlation: Float[Tensor, "world"]
    los_is_common: Float[Tensor, "world"]
    """1 where the line of sight has the same phase at all trackers, else 0."""


class WorldsFading:
    """Draws windows of a fixed number of samples."""

    def __init__(self, num_samples: int, device: torch.device | str = "cpu") -> None:
        grid = torch.linspace(math.log(SLOWEST), math.log(FASTEST), NUM_SPEEDS, dtype=torch.float64).exp()
        lag = torch.arange(num_samples, dtype=torch.float64)
        apart = (lag[:, None] - lag).abs()
        covariance = torch.special.bessel_j0(2 * math.pi * grid[:, None, None] * apart)
        value, vector = torch.linalg.eigh(covariance)
        # the symmetric root: eigenvectors' signs, which differ between processors, cancel out
        root = (vector * value.clamp(min=0.0).sqrt()[:, None]) @ vector.mT
        self._root = root.float().to(device)
        self._grid = grid.to(device)

    def drawn_db(
        self, worlds: FadingWorlds, num_windows: int, generator: torch.Generator
    ) -> Float[Tensor, "world window tracker sample"]:
        """20 log10 |h| of so many windows in each world."""
        root = self._root[(worlds.doppler_per_sample.double()[:, None] / self._grid).log().abs().argmin(dim=1)]
        num_worlds, num_samples, device = len(root), root.shape[1], root.device
        shape = (num_worlds, num_windows * NUM_TRACKERS * 2, num_samples)
        normal = torch.randn(shape, generator=generator, device=device) * math.sqrt(0.5)
        scattered = (normal @ root.transpose(1, 2)).view(num_worlds, num_windows, NUM_TRACKERS, 2, num_samples)
        rho, k = (part[:, None, None, None, None].float() for part in (worlds.spatial_correlation, worlds.rician_k))
        own = (1 - rho).sqrt()
        shared = ((1 + (NUM_TRACKERS - 1) * rho).sqrt() - own) / NUM_TRACKERS
        scattered = own * scattered + shared * scattered.sum(dim=2, keepdim=True)
        phase_rad = 2 * math.pi * torch.rand(num_worlds, num_windows, NUM_TRACKERS, generator=generator, device=device)
        phase_rad = torch.where(worlds.los_is_common[:, None, None] > 0, phase_rad[:, :, :1], phase_rad)
        line_of_sight = torch.stack([phase_rad.cos(), phase_rad.sin()], dim=3)[..., None]
        gain = (k.sqrt() * line_of_sight + scattered) / (k + 1).sqrt()
        level_db: Tensor = gain.square().sum(dim=3).clamp_(min=10 ** (DEEPEST_FADE_DB / 10)).log10_().mul_(10)
        return level_db
