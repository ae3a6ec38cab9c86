"""Training of what ``adaptive`` reads windows with: the fading in them, in worlds that nobody told it of.

No chase is flown for it. In every step it reads the first few windows of many chases, each in a world of its own, and
the loss is what the simulator knows of the fading there: - log of the density that the network gave it.
"""

import math
from dataclasses import dataclass

import torch

from ..batch.array_types import Bool, Float, Int, Tensor
from ..channel.fading_worlds import FASTEST, SLOWEST, FadingWorlds
from ..networks.windows import HeardWindows, WindowsLaw, WindowsNetwork
from ..observation import mean_power_dbm
from ..ranges import AT_LEAST_ONE, POSITIVE, SEED, ranged, require_ranges
from ..scenario import NUM_TRACKERS

TABLE_SHARE = 0.5
"""Each of K, Doppler spread and correlation is one of the paper's in so many of the worlds."""
TABLE_SPEEDS = (0.1, 0.05, 0.02, 0.01)
"""Doppler spread over sampling frequency."""
TABLE_CORRELATIONS = (0.1, 0.5, 0.9)
TABLE_K = 3.0
LARGEST_K = 15.0
NO_LINE_OF_SIGHT_SHARE = 0.16
"""Of the worlds whose K is not the paper's, those with K = 0."""
INDEPENDENT_SHARE = 0.2
"""Of the worlds: the line of sight has a phase of its own at every tracker."""
MISSING_SHARE, MOST_MISSING = 0.3, 0.7
"""Of the chases, those in which samples are missing, and of their samples."""
STEPS_SHARE = 0.25
"""Of the chases, those whose receivers report whole decibels."""
SILENT_SHARE = 0.2
"""Of the chases, those with one or two silent trackers."""
NOISY_SHARE, MOST_NOISE_DB = 0.25, 1.5
"""Of the chases, those whose receivers add noise, and its standard deviation."""


@dataclass(frozen=True, kw_only=True)
class WindowsSettings:
    """A training of a ``WindowsNetwork``."""

    worlds: int = ranged(512, AT_LEAST_ONE)
    """Of an update."""
    chases_per_world: int = ranged(2, AT_LEAST_ONE)
    windows: int = ranged(24, AT_LEAST_ONE)
    """Of a chase, at most."""
    learning_rate: float = ranged(2e-3, POSITIVE)
    """At first; it falls linearly to a thousandth."""
    max_gradient_norm: float = ranged(1.0, POSITIVE)
    """A longer gradient is shortened to this."""
    max_updates: int = ranged(25_800, AT_LEAST_ONE)
    seed: int = ranged(0, SEED)
    """Of worlds, fading and initial weights."""

    def __post_init__(self) -> None:
        require_ranges(self)


def drawn_worlds(number: int, generator: torch.Generator, device: torch.device | str) -> FadingWorlds:
    """Worlds of fading, half of each thing as in Table I."""

    def uniform() -> Float[Tensor, "world"]:
        return torch.rand(number, generator=generator, device=device)

    def from_table(values: tuple[float, ...], otherwise: Float[Tensor, "world"]) -> Float[Tensor, "world"]:
        table = torch.tensor(values, device=device)[(uniform() * len(values)).long()]
        return torch.where(uniform() < TABLE_SHARE, table, otherwise)

    slow, fast = math.log(2 * SLOWEST), math.log(FASTEST)
    k = torch.where(uniform() < NO_LINE_OF_SIGHT_SHARE, 0.0, LARGEST_K * uniform().square())
    return FadingWorlds(
        doppler_per_sample=from_table(TABLE_SPEEDS, (slow + (fast - slow) * uniform()).exp()),
        rician_k=from_table((TABLE_K,), k),
        spatial_correlation=from_table(TABLE_CORRELATIONS, 0.98 * uniform()),
        los_is_common=(uniform() >= INDEPENDENT_SHARE).float(),
    )


def reported_db(
    fading_db: Float[Tensor, "chase window sample 6"], generator: torch.Generator
) -> Float[Tensor, "chase window sample 6"]:
    """What receivers make of it: noise, steps of 1 dB, missing samples, silent ones, each in some chases."""
    num_chases, device = len(fading_db), fading_db.device

    def chosen(share: float) -> Bool[Tensor, "chase 1 1 1"]:
        return torch.rand(num_chases, 1, 1, 1, generator=generator, device=device) < share

    def uniform(*shape: int) -> Tensor:
        return torch.rand(shape, generator=generator, device=device)

    noise_db = torch.where(chosen(NOISY_SHARE), MOST_NOISE_DB * uniform(num_chases, 1, 1, 1), 0.0)
    noisy_db = fading_db + noise_db * torch.randn(fading_db.shape, generator=generator, device=device)
    place_db = uniform(num_chases, fading_db.shape[1], 1, NUM_TRACKERS)
    stepped_db = (noisy_db + place_db).round() - place_db
    heard_db = torch.where(chosen(STEPS_SHARE), stepped_db, noisy_db)
    share = torch.where(chosen(MISSING_SHARE), MOST_MISSING * uniform(num_chases, 1, 1, 1), 0.0)
    heard_db = heard_db.masked_fill(uniform(*fading_db.shape) < share, math.nan)
    silent = torch.where(chosen(SILENT_SHARE), 1 + (2 * uniform(num_chases, 1, 1, 1)).long(), 0)
    return heard_db.masked_fill(torch.arange(NUM_TRACKERS, device=device) < silent, math.nan)


def windows_loss(
    network: WindowsNetwork, heard_db: Float[Tensor, "chase window sample 6"], number: Int[Tensor, "chase"]
) -> Float[Tensor, ""]:
    """- log density of the mean powers' fading in the first ``number`` windows of each chase, a window's mean."""
    num_chases, num_windows = heard_db.shape[:2]
    flat = heard_db.flatten(0, 1)
    fading_db = mean_power_dbm(flat).view(num_chases, num_windows, NUM_TRACKERS)
    heard = network.heard(flat)
    own, together = (part.view(num_chases, num_windows, *part.shape[1:]) for part in (heard.own, heard.together))
    counts = torch.arange(num_windows, device=heard_db.device) < number[:, None]
    nats = negative_log_density(network.law(HeardWindows(own, together), counts), fading_db)
    return ((nats * counts).sum(dim=1) / number).mean()


def negative_log_density(law: WindowsLaw, fading_db: Float[Tensor, "*window 6"]) -> Float[Tensor, "*window"]:
    """Of these fadings, but for a constant; what is NaN was not heard."""
    counts = fading_db.isfinite()
    precision = torch.where(counts, law.apart_db.square().reciprocal(), 0.0)
    error_db = torch.where(counts, fading_db - law.mean_db, 0.0)
    variance = law.together_db.square()
    grows = 1 + variance * precision.sum(dim=-1)
    squared = (precision * error_db.square()).sum(dim=-1)
    squared = squared - variance / grows * (precision * error_db).sum(dim=-1).square()
    log_determinant = grows.log() + torch.where(counts, 2 * law.apart_db.log(), 0.0).sum(dim=-1)
    return (squared + log_determinant) / 2
