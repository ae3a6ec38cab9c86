"""What the trackers' receivers make of the signal: constant errors, missing samples, silence. The paper's are
perfect."""

from dataclasses import dataclass

import torch

from ..batch.array_types import Bool, Float, Tensor
from ..batch.streams import ChaseKey, ChaseStreams
from ..scenario import NUM_TRACKERS, Scenario


@dataclass(frozen=True)
class ReceiverState:
    """The receivers of each chase; None where nothing is wrong with any."""

    offset_db: Float[Tensor, "chase tracker"] | None
    """What each receiver adds to every sample, float32."""
    silent: Bool[Tensor, "chase tracker"] | None
    """Receivers that report nothing."""
    streams: ChaseStreams | None
    """Each chase's own random numbers for the samples that go missing."""


class Receivers:
    """The receivers of one scenario."""

    def __init__(self, scenario: Scenario, device: torch.device | str = "cpu") -> None:
        self._scenario = scenario
        self._device = torch.device(device)

    def begin(self, keys: list[ChaseKey]) -> ReceiverState:
        """The receivers that these chases have drawn."""
        scenario = self._scenario
        streams = ChaseStreams.of(keys, "receivers")
        offset_db = silent = None
        if scenario.receiver_offset_db > 0:
            drawn = 2 * streams.uniform(NUM_TRACKERS) - 1
            offset_db = (scenario.receiver_offset_db * drawn).float().to(self._device)
        if scenario.silent_trackers > 0:
            rank = streams.uniform(NUM_TRACKERS).argsort(dim=1).argsort(dim=1)
            silent = (rank < scenario.silent_trackers).to(self._device)
        return ReceiverState(offset_db, silent, streams if scenario.missing_sample_share > 0 else None)

    def reported_dbm(
        self, state: ReceiverState, rssi_dbm: Float[Tensor, "chase sample tracker"]
    ) -> Float[Tensor, "chase sample tracker"]:
        """What the receivers report of a window; a missing sample is NaN."""
        if state.offset_db is not None:
            rssi_dbm = rssi_dbm + state.offset_db[:, None]
        if state.silent is not None:
            rssi_dbm = rssi_dbm.masked_fill(state.silent[:, None], torch.nan)
        if state.streams is not None:
            uniform = state.streams.uniform(*rssi_dbm.shape[1:]).to(self._device)
            rssi_dbm = rssi_dbm.masked_fill(uniform < self._scenario.missing_sample_share, torch.nan)
        return rssi_dbm
