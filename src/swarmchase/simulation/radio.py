"""The target's transmissions as six receivers hear them at any moment of a live chase.

In the windows that the controller listens to, the channel is that of the evaluation, sample by sample: window k of
chase c of run s is the same in both. In between, while the trackers fly, other fading of the same law is heard. The
controller tells nobody where its windows begin, so a simulation has to be told: ``announce``.
"""

import math

import torch

from ..batch.array_types import Float, Tensor
from ..channel.fading import fading_db, window_time_s
from ..channel.fading_process import FadingState, fading_process
from ..channel.propagation import unfaded_dbm
from ..errors import InputError
from ..live.link.messages import Metres
from ..scenario import NUM_TRACKERS, Scenario
from ..world.receivers import Receivers
from ..world.target import draw_start_m

BREAK_BEFORE_S, BREAK_AFTER_S = 0.1, 0.02
"""Around the announced moment nothing is heard, and the window begins with the first sample after that: no two clocks
need to agree better than this."""


def require_simulated(scenario: Scenario) -> None:
    """Refuse a scenario whose trackers stop to listen with anything that the paper's world does not have.

    Raises:
        InputError: it has.
    """
    if scenario.departures:
        name = scenario.departures[0]
        raise InputError(
            f"{name} = {getattr(scenario, name)!r} is refused: the simulated site has the paper's world alone"
        )


class Radio:
    """Of one chase. The swarm starts around the origin; metres are of the frame that all share.

    Raises:
        InputError: a scenario with anything that the paper's world does not have.
    """

    def __init__(self, scenario: Scenario, seed: int, chase: int) -> None:
        require_simulated(scenario)
        keys = [(seed, chase)]
        self._scenario = scenario
        self._process, self._receivers = fading_process(scenario), Receivers(scenario)
        self._fading, self._receiver_state = self._process.begin(keys), self._receivers.begin(keys)
        self._between = self._process.begin(keys, "transit")
        self._begin_s, self._between_begin_s = torch.zeros(2, 1, dtype=torch.float64)
        """Of the announced window and of what is heard between windows, each by a clock of its own."""
        self._window_db: Tensor | None = None
        """The fading of the samples that are heard one after the other, [tracker, sample]."""
        self._sample = 0
        """The next one of the window."""
        self._is_between = True
        self._since_ns: int | None = None
        """Of the announced window, until it begins."""
        self._center_m: Tensor | None = None
        self._target_m = draw_start_m(scenario, keys)
        self._heard_m: Tensor | None = None
        self._unfaded_dbm = torch.full((NUM_TRACKERS,), math.nan)
        """At the last places that were heard from: in a window they stay."""

    @property
    def target_m(self) -> Metres:
        """Where the target is."""
        x_m, y_m, z_m = self._target_m[0].tolist()
        return x_m, y_m, z_m

    @property
    def target_mps(self) -> Metres:
        """It stands still."""
        return (0.0, 0.0, 0.0)

    def announce(self, since_ns: int, center_m: Metres) -> None:
        """The controller's next window is of what is sampled from this moment on, around this centre."""
        center = torch.tensor([center_m], dtype=torch.float64)
        if self._center_m is not None:
            travel_m = (center - self._center_m).norm(dim=1)
            self._begin_s = self._begin_s + self._scenario.window_s + travel_m / self._scenario.tracker_speed_mps
        self._center_m = center
        self._since_ns = since_ns

    def heard_dbm(self, time_ns: int, position_m: Float[Tensor, "tracker 3"]) -> list[float]:
        """What the receivers at these places report of the sample taken now; NaN where that is nothing."""
        if self._since_ns is not None and time_ns >= self._since_ns - BREAK_BEFORE_S * 1e9:
            if time_ns < self._since_ns + BREAK_AFTER_S * 1e9:
                return [math.nan] * NUM_TRACKERS
            self._since_ns, self._is_between = None, False
            self._fading = self._open(self._fading, self._begin_s)
        elif self._window_db is None or self._sample == self._scenario.window_samples:
            self._is_between = True
            self._between_begin_s = self._between_begin_s + self._scenario.window_s
            self._between = self._open(self._between, self._between_begin_s)
        assert self._window_db is not None
        if self._heard_m is None or not torch.equal(position_m, self._heard_m):
            distance_m = (position_m[None] - self._target_m[:, None]).norm(dim=2)
            self._heard_m, self._unfaded_dbm = position_m, unfaded_dbm(self._scenario, distance_m)[0].float()
        arriving_dbm = self._window_db[:, self._sample] + self._unfaded_dbm
        # The evaluation's receivers hear nothing between windows; what is heard there must not disturb them.
        if not self._is_between:
            sample_s = self._begin_s[:, None] + self._sample / self._scenario.sampling_hz
            reported_dbm, self._receiver_state = self._receivers.reported_dbm(
                self._receiver_state, sample_s, arriving_dbm[None, None]
            )
            arriving_dbm = reported_dbm[0, 0]
        self._sample += 1
        levels_dbm: list[float] = arriving_dbm.tolist()
        return levels_dbm

    def _open(self, fading: FadingState, begin_s: Float[Tensor, "chase"]) -> FadingState:
        window, fading = self._process.gain(fading, window_time_s(self._scenario, begin_s))
        self._window_db = fading_db(window)[0]
        self._sample = 0
        return fading
