"""A network that pursues in flight: from everything it has heard on its way it says where the target is, how fast it
flies, how sure that is, and how the swarm should fly otherwise than straight there.

An interval enters by each tracker's mean power, how far its samples scatter and what share of them there is, by where
the trackers were around their centre, and by how the centre has moved. A gated recurrent unit carries the belief. It is
told the transmit power alone, as the level at the reference distance; what it was trained on says how far to trust it.

A tracker without any sample is marked as such and stands at the mean of the others; an interval without any sample is
heard as one in which all six are marked.
"""

import copy
from dataclasses import dataclass

import torch
from torch import nn

from ..batch.array_types import Float, Tensor
from ..channel.propagation import reference_dbm
from ..flight import direction
from ..observation import mean_power_dbm
from ..scenario import NUM_TRACKERS, Scenario
from .protocol import Form, FormSettings, HearingNetworks

GATED_FEATURES = 256
HEAD_FEATURES = 192
TRACKER_FEATURES = 4
"""Level, whether there is one, spread and share of its samples."""
CENTER_FEATURES = 3
LEVEL_SCALE_DB, MEAN_SCALE_DB = 5.0, 20.0
TYPICAL_BELOW_REFERENCE_DB = -60.0
"""What trackers hear, against the level at the reference distance."""
OFFSET_SCALE_M, HEIGHT_SCALE_M, WAY_SCALE_M = 5.0, 50.0, 200.0
DISTANCE_SCALE_M, SPEED_SCALE_MPS, SPREAD_SCALE_M = 20.0, 5.0, 10.0
MOST_LOG_DISTANCE = 4.0
LEAST_LOG_SPREAD, MOST_LOG_SPREAD = -5.0, 3.0
NUM_OUTPUTS = 3 + 3 + 1 + 1 + 3
"""Direction, velocity, log distance, log spread, correction."""


@dataclass(frozen=True)
class PursuitReading:
    """What the network makes of all that a chase has heard, float32."""

    way_m: Float[Tensor, "chase 3"]
    """From the centre to the target."""
    velocity_mps: Float[Tensor, "chase 3"]
    """Of the target."""
    spread_m: Float[Tensor, "chase"]
    """Standard deviation of the target's place on each axis."""
    correction: Float[Tensor, "chase 3"]
    """What is added to the direction to the target, in full speeds."""
    value: Float[Tensor, "chase"]
    """What the critic expects of the chase from here on; for training alone."""

    @property
    def command(self) -> Float[Tensor, "chase 3"]:
        """The centre's velocity as a share of full speed, at most 1 long: straight to the target, corrected."""
        return at_most_one(direction(self.way_m.detach().double()).float() + self.correction)


class PursuitNetwork(HearingNetworks):
    """Its memory of a chase is one vector: the recurrent state, the last centre, and the level it is told."""

    form = "pursuit"
    memory_features = GATED_FEATURES + CENTER_FEATURES + 1
    batch_multiple = 16

    def __init__(self, generator: torch.Generator | None = None) -> None:
        """``generator`` draws the initial weights; without it they are left for a file to fill."""
        super().__init__()
        num_features = NUM_TRACKERS * (TRACKER_FEATURES + 3) + 2 * CENTER_FEATURES + 1
        with torch.random.fork_rng(devices=[]):
            if generator is not None:
                torch.manual_seed(int(torch.randint(2**31, (), generator=generator)))
            self.input = nn.Sequential(nn.Linear(num_features, GATED_FEATURES), nn.ReLU())
            self.recurrent = nn.GRUCell(GATED_FEATURES, GATED_FEATURES)
            self.head = nn.Sequential(
                nn.Linear(GATED_FEATURES, HEAD_FEATURES), nn.ReLU(), nn.Linear(HEAD_FEATURES, NUM_OUTPUTS)
            )
            self.critic = nn.Sequential(
                nn.Linear(GATED_FEATURES, HEAD_FEATURES), nn.ReLU(), nn.Linear(HEAD_FEATURES, 1)
            )
        if generator is not None:
            last = self.head[2]
            assert isinstance(last, nn.Linear)
            with torch.no_grad():  # straight to the target, until something better is learned
                last.weight[-3:].mul_(0.01)
                last.bias[-3:].zero_()

    def begin(self, scenario: Scenario, num_chases: int) -> Float[Tensor, "chase memory"]:
        """Nothing heard, the centre at its start, and the level at the reference distance."""
        memory = torch.zeros(num_chases, self.memory_features)
        memory[:, -1] = reference_dbm(scenario)
        return memory

    def forward(
        self,
        rssi_dbm: Float[Tensor, "chase sample 6"],
        tracker_position_m: Float[Tensor, "chase 6 3"],
        center_m: Float[Tensor, "chase 3"],
        memory: Float[Tensor, "chase memory"],
    ) -> tuple[PursuitReading, Float[Tensor, "chase memory"]]:
        """What it makes of one more interval, and the memory for the next.

        Args:
            tracker_position_m: averaged over the interval.
            center_m: of the swarm, at the end of the interval.
        """
        state, last_center_m, told_dbm = torch.split(memory, [GATED_FEATURES, CENTER_FEATURES, 1], dim=1)
        features = _features(rssi_dbm, tracker_position_m, center_m, center_m - last_center_m, told_dbm)
        state = self.recurrent(self.input(features), state)
        way, velocity, log_distance, log_spread, correction = self.head(state).split([3, 3, 1, 1, 3], dim=1)
        reading = PursuitReading(
            way_m=way * log_distance.clamp(-MOST_LOG_DISTANCE, MOST_LOG_DISTANCE).exp() * DISTANCE_SCALE_M,
            velocity_mps=velocity * SPEED_SCALE_MPS,
            spread_m=log_spread[:, 0].clamp(LEAST_LOG_SPREAD, MOST_LOG_SPREAD).exp() * SPREAD_SCALE_M,
            correction=correction,
            value=self.critic(state)[:, 0],
        )
        return reading, torch.cat([state, center_m, told_dbm], dim=1)


class PursuitForm(Form[PursuitNetwork, PursuitNetwork]):
    """The same network in files and in training."""

    name = PursuitNetwork.form
    file_format = "swarmchase-pursuit-1"
    objectives = frozenset()
    why_no_other_objective = "the form pursuit learns in flight: swarmchase train pursuit"
    window_samples = None
    filed = PursuitNetwork

    def new(self, settings: FormSettings, generator: torch.Generator | None) -> PursuitNetwork:
        """As ``Form.new``."""
        return PursuitNetwork(generator)

    def continued(self, settings: FormSettings, start: PursuitNetwork) -> PursuitNetwork:
        """As ``Form.continued``."""
        return start

    def deployed(self, trained: PursuitNetwork) -> PursuitNetwork:
        """As ``Form.deployed``."""
        return copy.deepcopy(trained)


def at_most_one(vector: Float[Tensor, "chase 3"]) -> Float[Tensor, "chase 3"]:
    """Vectors longer than 1 shortened to it."""
    shortened: Tensor = vector / vector.norm(dim=1, keepdim=True).clamp(min=1.0)
    return shortened


def _features(
    rssi_dbm: Float[Tensor, "chase sample 6"],
    tracker_position_m: Float[Tensor, "chase 6 3"],
    center_m: Float[Tensor, "chase 3"],
    step_m: Float[Tensor, "chase 3"],
    told_dbm: Float[Tensor, "chase 1"],
) -> Float[Tensor, "chase feature"]:
    rssi_dbm = rssi_dbm.contiguous()  # one layout in memory: else the last bits would depend on where it comes from
    power_dbm = mean_power_dbm(rssi_dbm)
    is_heard = power_dbm.isfinite()
    level_db = torch.where(is_heard, power_dbm - told_dbm, 0.0)
    mean_db = level_db.sum(dim=1, keepdim=True) / is_heard.sum(dim=1, keepdim=True).clamp(min=1)
    valid = rssi_dbm.isfinite()
    scatter_db = torch.where(valid, rssi_dbm - power_dbm[:, None], 0.0)
    share = valid.float().mean(dim=1)
    spread_db = (scatter_db.square().mean(dim=1) / share.clamp(min=1e-3)).sqrt()
    offset_m = tracker_position_m - tracker_position_m.mean(dim=1, keepdim=True)
    return torch.cat(
        [
            torch.where(is_heard, level_db - mean_db, 0.0) / LEVEL_SCALE_DB,
            is_heard.float(),
            spread_db / LEVEL_SCALE_DB,
            share,
            offset_m.flatten(1) / OFFSET_SCALE_M,
            step_m / OFFSET_SCALE_M,
            center_m[:, 2:] / HEIGHT_SCALE_M,
            center_m[:, :2] / WAY_SCALE_M,
            (mean_db - TYPICAL_BELOW_REFERENCE_DB) / MEAN_SCALE_DB,
        ],
        dim=1,
    )
