"""When the target transmits: in frames, with long silences, or one. The paper's does so all the time.

Remote ID beacons come 1 to 4 times a second, and a telemetry link is idle most of the time; what is sampled in between
is no level.
"""

from dataclasses import dataclass

import torch

from ..batch.array_types import Bool, Float, Tensor
from ..batch.streams import ChaseStreams
from ..errors import InputError
from ..scenario import Scenario
from .alternation import Alternation, AlternationState


@dataclass(frozen=True)
class TransmissionState:
    """What each target does."""

    frames: AlternationState | None
    """On while a frame lasts; None where it needs no frames."""
    silences: AlternationState | None
    """On while a long silence lasts; None where there are none."""
    streams: ChaseStreams
    """Each chase's own random numbers for what follows."""


class Transmissions:
    """The transmissions of one scenario's target.

    Raises:
        InputError: its only silence begins, and lasts no time.
    """

    def __init__(self, scenario: Scenario, device: torch.device | str = "cpu") -> None:
        self._device = torch.device(device)
        self._frames = self._silences = self._silence_s = None
        if scenario.silence_at_s is not None and scenario.silence_s == 0:
            raise InputError(
                f"silence_at_s = {scenario.silence_at_s:g} is refused: silence_s, its length, must be greater than 0"
            )
        if scenario.transmit_duty < 1:
            self._frames = Alternation(scenario.transmit_duty, scenario.frame_s)
        if scenario.silence_s > 0 and scenario.silence_at_s is not None:
            self._silence_s = scenario.silence_at_s, scenario.silence_at_s + scenario.silence_s
        elif scenario.silence_s > 0:
            share = scenario.silence_s / (scenario.silence_s + scenario.between_silences_s)
            self._silences = Alternation(share, scenario.silence_s)

    @property
    def pauses(self) -> bool:
        """Whether the target ever does not transmit."""
        return any(pause is not None for pause in (self._frames, self._silences, self._silence_s))

    def begin(self, streams: ChaseStreams) -> TransmissionState:
        """At the start of these chases, as found at any time of a long flight; draws from the streams."""
        uniform = streams.uniform(2, 1).to(self._device)
        return TransmissionState(
            frames=self._frames.begin(uniform[:, 0]) if self._frames else None,
            silences=self._silences.begin(uniform[:, 1]) if self._silences else None,
            streams=streams,
        )

    def at(
        self, state: TransmissionState, time_s: Float[Tensor, "chase sample"]
    ) -> tuple[Bool[Tensor, "chase sample"], TransmissionState]:
        """Whether it transmits at each of these times, which never go back."""
        uniform = state.streams.uniform(time_s.shape[1], 2, 1).to(self._device)
        transmits = torch.ones_like(time_s, dtype=torch.bool)
        frames, silences = state.frames, state.silences
        if self._frames and frames is not None:
            in_frame, frames = self._frames.at(frames, time_s, uniform[:, :, 0])
            transmits = in_frame[:, :, 0]
        if self._silences and silences is not None:
            silent, silences = self._silences.at(silences, time_s, uniform[:, :, 1])
            transmits = transmits & ~silent[:, :, 0]
        if self._silence_s is not None:
            begins_s, ends_s = self._silence_s
            transmits = transmits & ((time_s < begins_s) | (time_s >= ends_s))
        return transmits, TransmissionState(frames, silences, state.streams)
