"""What the trackers' receivers make of the signal. The paper's are perfect; real ones are not (each thing was found in
public recordings of WiFi, Bluetooth, LoRa and UAV links).

A sample goes through these in turn, each only where the scenario has it:

- Equal receivers differ by constant offsets, of 2 to 3 dB (``receiver_offset_db``); one of the wrong ones by 20 dB,
  as a broken antenna or another card's scale makes it (``wrong_trackers``).
- Below its noise floor a receiver hears nothing (``receiver_floor_dbm``). It reports in steps, nearly everywhere of
  1 dB (``receiver_step_db``), and nothing above its ceiling: close to a transmitter it saturates
  (``receiver_ceiling_dbm``).
- One that is stuck reports its first level for ever, whether there is something to hear or not (``stuck_trackers``).
- Error values stand among the levels, at any time (``garbage_share``).
- Samples get lost on their way, one by one or for a while (``missing_sample_share``, ``missing_burst_s``), and silent
  trackers report nothing (``silent_trackers``).
"""

from dataclasses import dataclass

import torch

from ..batch.array_types import Bool, Float, Tensor
from ..batch.streams import ChaseKey, ChaseStreams
from ..levels import ERROR_VALUES_DBM
from ..scenario import NUM_TRACKERS, Scenario
from .alternation import Alternation, AlternationState

WRONG_DB = 20.0
"""What a receiver that is wrong is off by."""
GARBAGE_DBM = (*ERROR_VALUES_DBM, 17.0, 121.0, -89.0)
"""What real receivers have been seen to report among true levels: their error values; +17 in 2 % of a monitor-mode WiFi
card's samples; up to +121; a single -89 among -36."""


@dataclass(frozen=True)
class ReceiverState:
    """The receivers of each chase; None where nothing is wrong with any."""

    offset_db: Float[Tensor, "chase tracker"] | None
    """What each receiver adds to every sample, float32."""
    silent: Bool[Tensor, "chase tracker"] | None
    """Receivers that report nothing."""
    stuck: Bool[Tensor, "chase tracker"] | None
    """Receivers whose level stays."""
    stuck_dbm: Float[Tensor, "chase tracker"] | None
    """The level at which it stays, float32; NaN until there is one, and where it does not."""
    gaps: AlternationState | None
    """On while what a tracker reports gets lost."""
    streams: ChaseStreams | None
    """Each chase's own random numbers for what happens to single samples."""


class Receivers:
    """The receivers of one scenario."""

    def __init__(self, scenario: Scenario, device: torch.device | str = "cpu") -> None:
        self._scenario = scenario
        self._device = torch.device(device)
        self._gaps = None
        if scenario.missing_sample_share > 0 and scenario.missing_burst_s > 0:
            self._gaps = Alternation(scenario.missing_sample_share, scenario.missing_burst_s)

    def begin(self, keys: list[ChaseKey]) -> ReceiverState:
        """The receivers that these chases have drawn."""
        scenario = self._scenario
        streams = ChaseStreams.of(keys, "receivers")
        offset_db = silent = stuck = stuck_dbm = gaps = None
        if scenario.receiver_offset_db > 0:
            drawn = 2 * streams.uniform(NUM_TRACKERS) - 1
            offset_db = (scenario.receiver_offset_db * drawn).float().to(self._device)
        if scenario.silent_trackers > 0:
            silent = self._some(scenario.silent_trackers, streams)
        if scenario.wrong_trackers > 0:
            wrong = self._some(scenario.wrong_trackers, streams)
            sign = torch.where(streams.uniform(NUM_TRACKERS).to(self._device) < 0.5, -WRONG_DB, WRONG_DB)
            wrong_db = torch.where(wrong, sign, 0.0).float()
            offset_db = wrong_db if offset_db is None else offset_db + wrong_db
        if scenario.stuck_trackers > 0:
            stuck = self._some(scenario.stuck_trackers, streams)
            stuck_dbm = torch.full(stuck.shape, torch.nan, device=self._device)
        if self._gaps:
            gaps = self._gaps.begin(streams.uniform(NUM_TRACKERS).to(self._device))
        draws_on = scenario.missing_sample_share > 0 or scenario.garbage_share > 0
        return ReceiverState(offset_db, silent, stuck, stuck_dbm, gaps, streams if draws_on else None)

    def reported_dbm(
        self,
        state: ReceiverState,
        time_s: Float[Tensor, "chase sample"],
        rssi_dbm: Float[Tensor, "chase sample tracker"],
    ) -> tuple[Float[Tensor, "chase sample tracker"], ReceiverState]:
        """What the receivers report of what arrives at these times, which never go back; a missing sample is NaN."""
        scenario = self._scenario
        if state.offset_db is not None:
            rssi_dbm = rssi_dbm + state.offset_db[:, None]
        if scenario.receiver_floor_dbm is not None:
            rssi_dbm = rssi_dbm.masked_fill(rssi_dbm < scenario.receiver_floor_dbm, torch.nan)
        if scenario.receiver_step_db > 0:
            rssi_dbm = (rssi_dbm / scenario.receiver_step_db).round() * scenario.receiver_step_db
        if scenario.receiver_ceiling_dbm is not None:
            rssi_dbm = rssi_dbm.clamp_max(scenario.receiver_ceiling_dbm)
        stuck_dbm, gaps = state.stuck_dbm, state.gaps
        if state.stuck is not None and stuck_dbm is not None:
            rssi_dbm, stuck_dbm = _stuck(rssi_dbm, state.stuck, stuck_dbm)
        missing, garbage = self._drawn(state, rssi_dbm)
        if garbage is not None:
            number = (garbage * (len(GARBAGE_DBM) / scenario.garbage_share)).long().clamp_max(len(GARBAGE_DBM) - 1)
            values_dbm = torch.tensor(GARBAGE_DBM, device=self._device)
            rssi_dbm = torch.where(garbage < scenario.garbage_share, values_dbm[number], rssi_dbm)
        if state.silent is not None:
            rssi_dbm = rssi_dbm.masked_fill(state.silent[:, None], torch.nan)
        if missing is not None:
            lost = missing < scenario.missing_sample_share
            if self._gaps and gaps is not None:
                lost, gaps = self._gaps.at(gaps, time_s, missing)
            rssi_dbm = rssi_dbm.masked_fill(lost, torch.nan)
        if stuck_dbm is state.stuck_dbm and gaps is state.gaps:
            return rssi_dbm, state
        return rssi_dbm, ReceiverState(state.offset_db, state.silent, state.stuck, stuck_dbm, gaps, state.streams)

    def _some(self, number: int, streams: ChaseStreams) -> Bool[Tensor, "chase tracker"]:
        """So many trackers of each chase, drawn."""
        rank = streams.uniform(NUM_TRACKERS).argsort(dim=1).argsort(dim=1)
        return (rank < number).to(self._device)

    def _drawn(
        self, state: ReceiverState, rssi_dbm: Float[Tensor, "chase sample tracker"]
    ) -> tuple[Float[Tensor, "chase sample tracker"] | None, Float[Tensor, "chase sample tracker"] | None]:
        """A number for each sample that may go missing and one for each that may be garbage, sample after sample."""
        if state.streams is None:
            return None, None
        _, num_samples, num_trackers = rssi_dbm.shape
        if self._scenario.garbage_share == 0:
            return state.streams.uniform(num_samples, num_trackers).to(self._device), None
        drawn = state.streams.uniform(num_samples, 2, num_trackers).to(self._device)
        return drawn[:, :, 0] if self._scenario.missing_sample_share > 0 else None, drawn[:, :, 1]


def _stuck(
    rssi_dbm: Float[Tensor, "chase sample tracker"],
    stuck: Bool[Tensor, "chase tracker"],
    stuck_dbm: Float[Tensor, "chase tracker"],
) -> tuple[Float[Tensor, "chase sample tracker"], Float[Tensor, "chase tracker"]]:
    """What is reported where some stay at their first level, and that level."""
    heard = ~rssi_dbm.isnan()
    first_dbm = rssi_dbm.gather(1, heard.int().argmax(dim=1, keepdim=True))[:, 0]
    begun = ~stuck_dbm.isnan()
    stuck_dbm = torch.where(begun | ~stuck, stuck_dbm, first_dbm)
    stays = stuck[:, None] & (begun[:, None] | (heard.cumsum(dim=1) > 0))
    return torch.where(stays, stuck_dbm[:, None], rssi_dbm), stuck_dbm
