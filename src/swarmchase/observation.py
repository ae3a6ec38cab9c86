"""What a controller gets to see."""

import math
from dataclasses import dataclass, replace

import torch

from .batch.array_types import Bool, Float, Tensor
from .batch.shown import shown_chases
from .errors import InputError
from .levels import FEWEST_TO_COMPARE, WILD_DB, highest_dbm, is_level, quartile_place
from .scenario import Scenario

NEPERS_PER_DB = math.log(10) / 10
"""Of power: its natural logarithm over its level in dB."""
LONGEST_S = 60.0
"""A longer time between two samples or two decisions counts as this."""


@dataclass(frozen=True, repr=False)
class Observation:
    """One window of every chase in a batch.

    >>> heard_dbm = torch.full((2, 50, 6), -71.5)
    >>> heard_dbm[0, :, 3] = torch.nan
    >>> Observation(heard_dbm, tracker_position_m=torch.zeros(2, 50, 6, 3))
    Observation(2 chases, 50 samples, 6 trackers: -71.5 to -71.5 dBm, 8 % missing)

    Raises:
        InputError: shapes that do not belong together.
    """

    rssi_dbm: Float[Tensor, "chase sample tracker"]
    """S_t, Eq. (6); a missing sample is NaN."""
    tracker_position_m: Float[Tensor, "chase sample tracker 3"]
    """Where each sample was taken, in the chase's own frame (origin: the centre's start)."""
    time_s: Float[Tensor, "chase sample"] | None = None
    """When, in seconds since any moment; None where samples are 1 / F apart."""

    def __post_init__(self) -> None:
        if self.rssi_dbm.ndim != 3 or self.tracker_position_m.shape != (*self.rssi_dbm.shape, 3):
            raise InputError(
                f"rssi_dbm {tuple(self.rssi_dbm.shape)} must be [chase, sample, tracker] and tracker_position_m "
                f"{tuple(self.tracker_position_m.shape)} the same with three coordinates"
            )
        if self.time_s is not None and self.time_s.shape != self.rssi_dbm.shape[:2]:
            raise InputError(
                f"time_s {tuple(self.time_s.shape)} must be [chase, sample] of rssi_dbm {tuple(self.rssi_dbm.shape)}"
            )

    def __repr__(self) -> str:
        chases, samples, trackers = self.rssi_dbm.shape
        heard_dbm = self.rssi_dbm[~self.rssi_dbm.isnan()]
        levels = f"{heard_dbm.min():.1f} to {heard_dbm.max():.1f} dBm" if len(heard_dbm) else "nothing heard"
        missing = 1 - len(heard_dbm) / max(self.rssi_dbm.numel(), 1)
        times = "" if self.time_s is None else ", with times"
        size = f"{shown_chases(chases)}, {samples} samples, {trackers} trackers"
        return f"Observation({size}: {levels}, {100 * missing:.0f} % missing{times})"


def checked_observation(observation: Observation, scenario: Scenario) -> Observation:
    """The observation as controllers take it in: what is no level of the scenario's transmitter is missing
    (``levels``), and so is what is wild in its window. One without any such thing is returned as it is.

    Raises:
        InputError: a position that is no finite number.
    """
    if not observation.tracker_position_m.isfinite().all():
        raise InputError(
            "tracker_position_m must be finite: for a tracker whose place is not known give the place where it should "
            "be, and NaN for its levels"
        )
    reported_dbm = observation.rssi_dbm
    kept = is_level(reported_dbm, highest_dbm(scenario)) | reported_dbm.isnan()
    rssi_dbm = reported_dbm if kept.all() else torch.where(kept, reported_dbm, torch.nan)
    wild = wild_samples(rssi_dbm)
    if wild is not None:
        rssi_dbm = torch.where(wild, torch.nan, rssi_dbm)
    return observation if rssi_dbm is reported_dbm else replace(observation, rssi_dbm=rssi_dbm)


def wild_samples(rssi_dbm: Float[Tensor, "chase sample tracker"]) -> Bool[Tensor, "chase sample tracker"] | None:
    """Which samples are more than ``WILD_DB`` above the upper quartile of their tracker's window; None where none is.

    One sample of 50 that is 55 dB too strong adds 38 dB to their mean power; what this leaves adds 6 dB at most.
    """
    valid = rssi_dbm.isfinite()
    number = valid.sum(dim=1)
    total_db = torch.where(valid, rssi_dbm, 0.0).sum(dim=1)
    strongest_dbm = torch.where(valid, rssi_dbm, -torch.inf).amax(dim=1)
    # Where the strongest is far above three quarters of them, it is far above their mean: few windows need be sorted.
    suspicious = (number >= FEWEST_TO_COMPARE) & (strongest_dbm - total_db / number > 0.75 * WILD_DB - 1)
    if not suspicious.any():
        return None
    rising_dbm = torch.where(valid, rssi_dbm, torch.inf).sort(dim=1).values
    quartile_dbm = rising_dbm.gather(1, quartile_place(number.clamp(min=1))[:, None])
    wild: Tensor = suspicious[:, None] & valid & (rssi_dbm - quartile_dbm > WILD_DB)
    return wild if wild.any() else None


def mean_power_dbm(rssi_dbm: Float[Tensor, "chase sample tracker"]) -> Float[Tensor, "chase tracker"]:
    """The mean power of each tracker's valid samples, averaged in milliwatts; NaN where a tracker has none.

    Of all simple statistics of a window it says most about the distance: the mean of its dB values is spoilt by a
    few deep fades.
    """
    # One layout in memory, and exp in the place of a power of ten: else the last bits would depend on the batch.
    rssi_dbm = rssi_dbm.float().transpose(1, 2).contiguous()
    valid = rssi_dbm.isfinite()
    # Relative to the strongest sample: ten to the power of a level below -380 dBm would be no float32.
    strongest_dbm = torch.where(valid, rssi_dbm, -torch.inf).amax(dim=2)
    relative = torch.where(valid, ((rssi_dbm - strongest_dbm[..., None]) * NEPERS_PER_DB).exp(), 0.0)
    return strongest_dbm + 10 * torch.log10(relative.sum(dim=2) / valid.sum(dim=2))


def sample_age_s(
    observation: Observation, scenario: Scenario, before_s: Float[Tensor, "chase"]
) -> tuple[Float[Tensor, "chase"], Float[Tensor, "chase"], Float[Tensor, "chase sample"]]:
    """When the last sample was taken, how long after the last one of the observation before, and how long before it
    each sample was taken; float64.

    Args:
        before_s: the first of these of the observation before; NaN where there was none, and then a decision's
            interval lies between.
    """
    num_chases, num_samples = observation.rssi_dbm.shape[:2]
    if observation.time_s is None:
        age_s = torch.arange(num_samples - 1, -1, -1, dtype=torch.float64).expand(num_chases, -1)
        age_s = age_s / scenario.sampling_hz
        time_s = before_s.nan_to_num(nan=0.0) + num_samples / scenario.sampling_hz
    else:
        time_s = observation.time_s[:, -1].double()
        age_s = (time_s[:, None] - observation.time_s.double()).nan_to_num(nan=0.0).clamp(0.0, LONGEST_S)
    lasted_s = time_s - before_s
    return time_s, torch.where(lasted_s.isfinite(), lasted_s, scenario.decision_s).clamp(0.0, LONGEST_S), age_s


def mean_position_m(observation: Observation) -> Float[Tensor, "chase tracker 3"]:
    """Where each tracker was in the window, averaged over its samples, float64."""
    return observation.tracker_position_m.double().contiguous().mean(dim=1)


def center_m(observation: Observation) -> Float[Tensor, "chase 3"]:
    """The centre of the swarm at the end of the window, float64."""
    return observation.tracker_position_m[:, -1].double().mean(dim=1)
