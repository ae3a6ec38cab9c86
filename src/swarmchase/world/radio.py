"""What the swarm's receivers report of the target's transmissions: path loss, fading, receivers (Eqs. 1-5)."""

import torch

from ..batch.array_types import Float, Tensor
from ..batch.streams import ChaseKey
from ..channel.fading import FadingProcess, FadingState, fading_db
from ..channel.propagation import unfaded_dbm
from ..scenario import Scenario
from .receivers import Receivers, ReceiverState


def rssi_dbm(
    scenario: Scenario, distance_m: Float[Tensor, "chase tracker"], fading: Float[Tensor, "chase tracker 2 sample"]
) -> Float[Tensor, "chase sample tracker"]:
    """Eq. (1): the RSSI window that arrives at six trackers at these distances, float32."""
    return fading_db(fading).add_(unfaded_dbm(scenario, distance_m).float()[:, :, None]).transpose(1, 2)


class Radio:
    """The radio channel of one scenario, from the target's antenna to what the receivers say."""

    def __init__(self, scenario: Scenario, device: torch.device | str = "cpu") -> None:
        self._scenario = scenario
        self.fading = FadingProcess(scenario, device)
        """Between the target and the receivers."""
        self._receivers = Receivers(scenario, device)

    def begin(self, keys: list[ChaseKey]) -> tuple[FadingState, ReceiverState]:
        """The fading and the receivers of these chases before their first window."""
        return self.fading.begin(keys), self._receivers.begin(keys)

    def heard_dbm(
        self, distance_m: Float[Tensor, "chase tracker"], fading: FadingState, receivers: ReceiverState
    ) -> Float[Tensor, "chase sample tracker"]:
        """The window that trackers at these distances report, float32; a missing sample is NaN."""
        arriving_dbm = rssi_dbm(self._scenario, distance_m, self.fading.window(fading))
        return self._receivers.reported_dbm(receivers, arriving_dbm)
