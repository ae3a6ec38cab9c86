"""What the swarm's receivers report of the target's transmissions, from its antenna to what they say.

In the paper's world that is path loss and fading (Eqs. 1-5). Others may add shadowing, the ground's reflection, a
transmit power and an exponent that are not those of the scenario, a target that does not always transmit, and receivers
that are not perfect.
"""

from dataclasses import dataclass

import torch

from ..batch.array_types import Float, Tensor
from ..batch.streams import ChaseKey, ChaseStreams
from ..channel.fading import fading_db
from ..channel.fading_process import FadingState, fading_process
from ..channel.propagation import ground_reflection_db, loss_beyond_reference_db, unfaded_dbm
from ..channel.shadowing import Shadowing, ShadowingState
from ..scenario import NUM_TRACKERS, Scenario
from .receivers import Receivers, ReceiverState
from .transmissions import Transmissions, TransmissionState


@dataclass(frozen=True)
class ErrorState:
    """How each chase's channel differs from its scenario; None where it does not."""

    power_db: Float[Tensor, "chase"] | None
    """Transmit power, over that of the scenario, float64."""
    exponent: Float[Tensor, "chase"] | None
    """Path loss exponent, over that of the scenario, float64."""


@dataclass(frozen=True)
class RadioState:
    """What the radio of each chase carries from call to call."""

    fading: FadingState
    """Between the target and the receivers."""
    receivers: ReceiverState
    """What is wrong with each chase's receivers."""
    shadowing: ShadowingState | None
    """What stands in the way; None where nothing does."""
    transmissions: TransmissionState | None
    """What the target does; None where it always transmits."""
    errors: ErrorState
    """What the scenario does not say."""
    relative_position_m: Float[Tensor, "chase tracker 3"] | None
    """Of the trackers at the last sample, seen from the target, float64; NaN before the first, and None where fading
    does not look at it."""


def rssi_dbm(
    scenario: Scenario,
    distance_m: Float[Tensor, "chase place tracker"],
    fading: Float[Tensor, "chase tracker 2 sample"],
) -> Float[Tensor, "chase sample tracker"]:
    """Eq. (1): the RSSI that arrives at six trackers at these distances, float32; one place is that of all samples."""
    return _faded_dbm(unfaded_dbm(scenario, distance_m), fading)


class Radio:
    """The radio channel of one scenario."""

    def __init__(self, scenario: Scenario, device: torch.device | str = "cpu") -> None:
        self._scenario = scenario
        self._device = torch.device(device)
        self._fading = fading_process(scenario, device)
        self._receivers = Receivers(scenario, device)
        self._shadowing = Shadowing(scenario, device)
        self._transmissions = Transmissions(scenario, device)

    def begin(self, keys: list[ChaseKey]) -> RadioState:
        """The radio of these chases before their first sample."""
        scenario = self._scenario
        power_db = exponent = transmissions = relative_position_m = None
        if self._transmissions.pauses or scenario.transmit_power_error_db > 0 or scenario.path_loss_exponent_error > 0:
            streams = ChaseStreams.of(keys, "transmissions")
            error = (2 * streams.uniform(2) - 1).to(self._device)
            if scenario.transmit_power_error_db > 0:
                power_db = scenario.transmit_power_error_db * error[:, 0]
            if scenario.path_loss_exponent_error > 0:
                exponent = scenario.path_loss_exponent_error * error[:, 1]
            if self._transmissions.pauses:
                transmissions = self._transmissions.begin(streams)
        if self._fading.heeds_motion:
            shape = (len(keys), NUM_TRACKERS, 3)
            relative_position_m = torch.full(shape, torch.nan, dtype=torch.float64, device=self._device)
        return RadioState(
            fading=self._fading.begin(keys),
            receivers=self._receivers.begin(keys),
            shadowing=self._shadowing.begin(keys) if scenario.shadowing_db > 0 else None,
            transmissions=transmissions,
            errors=ErrorState(power_db, exponent),
            relative_position_m=relative_position_m,
        )

    def heard_dbm(
        self,
        state: RadioState,
        time_s: Float[Tensor, "chase sample"],
        target_position_m: Float[Tensor, "chase place 3"],
        tracker_position_m: Float[Tensor, "chase place tracker 3"],
    ) -> tuple[Float[Tensor, "chase sample tracker"], RadioState]:
        """What trackers at these places report of samples taken at these times, float32; a missing sample is NaN.

        Args:
            state: the radio as the call before left it; the chase's own random numbers in it go on.
            time_s: since the chase began, float64, never going back.
            target_position_m: where the target is at each sample, or one place for all of them, float64.
            tracker_position_m: where the trackers are, as many places as the target's, float64.
        """
        relative_position_m = tracker_position_m - target_position_m[:, :, None]
        moved_m = last_position_m = None
        if state.relative_position_m is not None:
            moved_m = _moved_m(state.relative_position_m, relative_position_m, time_s.shape[1])
            last_position_m = relative_position_m[:, -1]
        fading, fading_state = self._fading.gain(state.fading, time_s, moved_m)
        distance_m = torch.linalg.vector_norm(relative_position_m, dim=3)
        arriving_dbm = _faded_dbm(self._mean_dbm(state, target_position_m, tracker_position_m, distance_m), fading)
        transmissions = state.transmissions
        if transmissions is not None:
            transmits, transmissions = self._transmissions.at(transmissions, time_s)
            arriving_dbm = arriving_dbm.masked_fill(~transmits[:, :, None], torch.nan)
        reported_dbm, receivers = self._receivers.reported_dbm(state.receivers, time_s, arriving_dbm)
        following = RadioState(fading_state, receivers, state.shadowing, transmissions, state.errors, last_position_m)
        return reported_dbm, following

    def _mean_dbm(
        self,
        state: RadioState,
        target_position_m: Float[Tensor, "chase place 3"],
        tracker_position_m: Float[Tensor, "chase place tracker 3"],
        distance_m: Float[Tensor, "chase place tracker"],
    ) -> Float[Tensor, "chase place tracker"]:
        """What would arrive if nothing faded, float64."""
        scenario = self._scenario
        mean_dbm = unfaded_dbm(scenario, distance_m)
        if state.errors.power_db is not None:
            mean_dbm = mean_dbm + state.errors.power_db[:, None, None]
        if state.errors.exponent is not None:
            share = state.errors.exponent / scenario.path_loss_exponent
            mean_dbm = mean_dbm - loss_beyond_reference_db(scenario, distance_m) * share[:, None, None]
        if state.shadowing is not None:
            mean_dbm = mean_dbm + self._shadowing.added_db(state.shadowing, target_position_m, tracker_position_m)
        if scenario.ground_reflection > 0:
            mean_dbm = mean_dbm + ground_reflection_db(scenario, target_position_m[:, :, None], tracker_position_m)
        return mean_dbm


def _faded_dbm(
    mean_dbm: Float[Tensor, "chase place tracker"], fading: Float[Tensor, "chase tracker 2 sample"]
) -> Float[Tensor, "chase sample tracker"]:
    return fading_db(fading).add_(mean_dbm.float().transpose(1, 2)).transpose(1, 2)


def _moved_m(
    before_m: Float[Tensor, "chase tracker 3"],
    relative_position_m: Float[Tensor, "chase place tracker 3"],
    num_samples: int,
) -> Float[Tensor, "chase sample tracker"]:
    """How far each tracker has moved as seen from the target since the sample before; nowhere before the first."""
    moved_m: Tensor = relative_position_m.diff(dim=1, prepend=before_m[:, None]).norm(dim=3)
    moved_m[:, 0].nan_to_num_(0.0)
    if moved_m.shape[1] == num_samples:
        return moved_m
    at_one_place = moved_m.new_zeros(len(moved_m), num_samples, moved_m.shape[2])
    at_one_place[:, 0] = moved_m[:, 0]
    return at_one_place
