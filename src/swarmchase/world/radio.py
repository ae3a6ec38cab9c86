"""What the swarm's receivers report of the target's transmissions: path loss, fading, receivers (Eqs. 1-5)."""

from dataclasses import dataclass

import torch

from ..batch.array_types import Float, Tensor
from ..batch.streams import ChaseKey
from ..channel.fading import fading_db
from ..channel.fading_process import FadingState, fading_process
from ..channel.propagation import unfaded_dbm
from ..scenario import Scenario
from .receivers import Receivers, ReceiverState


@dataclass(frozen=True)
class RadioState:
    """What the radio of each chase carries from call to call."""

    fading: FadingState
    """Between the target and the receivers."""
    receivers: ReceiverState
    """What is wrong with each chase's receivers."""


def rssi_dbm(
    scenario: Scenario,
    distance_m: Float[Tensor, "chase place tracker"],
    fading: Float[Tensor, "chase tracker 2 sample"],
) -> Float[Tensor, "chase sample tracker"]:
    """Eq. (1): the RSSI that arrives at six trackers at these distances, float32; one place is that of all samples."""
    return fading_db(fading).add_(unfaded_dbm(scenario, distance_m).float().transpose(1, 2)).transpose(1, 2)


class Radio:
    """The radio channel of one scenario, from the target's antenna to what the receivers say."""

    def __init__(self, scenario: Scenario, device: torch.device | str = "cpu") -> None:
        self._scenario = scenario
        self._fading = fading_process(scenario, device)
        self._receivers = Receivers(scenario, device)

    def begin(self, keys: list[ChaseKey]) -> RadioState:
        """The radio of these chases before their first sample."""
        return RadioState(self._fading.begin(keys), self._receivers.begin(keys))

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
        distance_m = (tracker_position_m - target_position_m[:, :, None]).norm(dim=3)
        fading, fading_state = self._fading.gain(state.fading, time_s)
        arriving_dbm = rssi_dbm(self._scenario, distance_m, fading)
        reported_dbm = self._receivers.reported_dbm(state.receivers, arriving_dbm)
        return reported_dbm, RadioState(fading_state, state.receivers)
