"""The network with memory: decides from everything a chase has heard and where the trackers were.

A window enters by its six mean powers, by a short description of the shape of each tracker's fifty samples, learned by
one small network for all six, and by where the trackers were. A gated recurrent unit carries the belief from movement
to movement; its state gives the rewards of all choices, as in counterfactual regression. The description matters where
fading is slow against a window: at 100 Hz a tracker in a fade shows it by its slope and curvature, and how far the mean
power is from the path loss is then known to 1.7 dB instead of 2.6 dB.

It knows what it is told of the scenario: F and rho. Missing samples (NaN) are filled with the tracker's mean and a
tracker that is silent is marked as such; a window without any sample changes nothing.
"""

import math

import torch
from torch import nn

from ..batch.array_types import Float, Tensor
from ..scenario import NUM_TRACKERS, Scenario
from .actor_critic import (
    LEVEL_CENTER_DBM,
    LEVEL_SCALE_DB,
    NETWORK_NAMES,
    NUM_CHOICES,
    PAIR_DIFFERENCE_SCALE_DB,
    PAPER_WINDOW_SAMPLES,
)
from .protocol import DecidingNetworks, Form, FormSettings

SHAPE_FEATURES = 16
SHAPE_HIDDEN_FEATURES = 64
SHAPE_SCALE_DB = 5.0
GATED_FEATURES = 192
HEAD_FEATURES = 128
POSITION_SCALE_M = 50.0
STEP_SCALE_M = 4.0
DECADE_DB = 26.0
"""Levels become distances with Table I's path loss exponent: ten times as far is this much weaker."""
LEVEL_50_M_DBM = -51.2
"""The level that Table I gives 50 m away."""
WILDEST_DB = 150.0
"""Levels further than this from their centre are cut off: no receiver means them."""
MOST_DISTANCE = 6.0
"""Such distances are cut off here, in units of 50 m."""
TOLD_FEATURES = 2
CENTER_FEATURES = 3


class GatedNetwork(DecidingNetworks):
    """One network for spacing, x, y and z.

    Its memory of a chase is one vector: the recurrent state, the last centre and what it was told of the scenario.
    """

    form = "gated"
    memory_features = GATED_FEATURES + CENTER_FEATURES + TOLD_FEATURES
    batch_multiple = 16
    share_position = 3 + 3 + 1 + NUM_TRACKERS + NUM_TRACKERS * SHAPE_FEATURES
    """Where the six shares of valid samples begin among what it hears in a window."""

    def __init__(self, generator: torch.Generator | None = None, policy_scale: float = 1.0) -> None:
        """``generator`` draws the initial weights; without it they are left for a file to fill.

        Logits are the head's outputs times ``policy_scale``.
        """
        super().__init__()
        self.policy_scale = policy_scale
        num_features = self.share_position + NUM_TRACKERS + 2 * CENTER_FEATURES + 1 + TOLD_FEATURES
        with torch.random.fork_rng(devices=[]):
            if generator is not None:
                torch.manual_seed(int(torch.randint(2**31, (), generator=generator)))
            self.shape = nn.Sequential(
                nn.Linear(PAPER_WINDOW_SAMPLES, SHAPE_HIDDEN_FEATURES),
                nn.ReLU(),
                nn.Linear(SHAPE_HIDDEN_FEATURES, SHAPE_FEATURES),
            )
            self.input = nn.Sequential(nn.Linear(num_features, GATED_FEATURES), nn.ReLU())
            self.recurrent = nn.GRU(GATED_FEATURES, GATED_FEATURES)
            self.head = nn.Sequential(
                nn.Linear(GATED_FEATURES, HEAD_FEATURES),
                nn.ReLU(),
                nn.Linear(HEAD_FEATURES, len(NETWORK_NAMES) * NUM_CHOICES),
            )

    def with_policy_scale(self, policy_scale: float) -> "GatedNetwork":
        """A network with the same policies and another ``policy_scale``; the head's weights make up for it."""
        scaled = GatedNetwork(policy_scale=policy_scale)
        scaled.load_state_dict(self.state_dict())
        last = scaled.head[2]
        assert isinstance(last, nn.Linear)
        with torch.no_grad():
            for parameter in (last.weight, last.bias):
                parameter.mul_(self.policy_scale / policy_scale)
        return scaled

    def begin(self, scenario: Scenario, num_chases: int) -> Float[Tensor, "chase memory"]:
        """The memory before the first window: nothing heard, the centre at its start, and what it is told."""
        memory = torch.zeros(num_chases, self.memory_features)
        memory[:, -2] = math.log10(scenario.sampling_hz) - 1.5
        memory[:, -1] = scenario.spatial_correlation - 0.5
        return memory

    def decide(
        self,
        rssi_dbm: Float[Tensor, "chase sample 6"],
        tracker_position_m: Float[Tensor, "chase 6 3"],
        memory: Float[Tensor, "chase memory"],
    ) -> tuple[Float[Tensor, "chase 4 5"], Float[Tensor, "chase memory"]]:
        """Logits of the four policies, and the memory for the next window."""
        logits, memory = self._through(rssi_dbm[None], tracker_position_m[None], memory)
        return logits[0], memory

    def decide_in_sequence(
        self,
        rssi_dbm: Float[Tensor, "step chase sample 6"],
        tracker_position_m: Float[Tensor, "step chase 6 3"],
        memory: Float[Tensor, "chase memory"],
    ) -> Float[Tensor, "step chase 4 5"]:
        """Logits of the four policies at every step of a rollout that began with ``memory``."""
        return self._through(rssi_dbm, tracker_position_m, memory)[0]

    def _through(
        self,
        rssi_dbm: Float[Tensor, "step chase sample 6"],
        tracker_position_m: Float[Tensor, "step chase 6 3"],
        memory: Float[Tensor, "chase memory"],
    ) -> tuple[Float[Tensor, "step chase 4 5"], Float[Tensor, "chase memory"]]:
        parts = [GATED_FEATURES, CENTER_FEATURES, TOLD_FEATURES]
        state, last_center_m, told = torch.split(memory, parts, dim=1)
        center_m = tracker_position_m.mean(dim=2)
        before_m = torch.cat([last_center_m[None], center_m[:-1]])
        features = torch.cat(
            [
                self._heard(rssi_dbm),
                center_m / POSITION_SCALE_M,
                (center_m - before_m) / STEP_SCALE_M,
                (tracker_position_m - center_m[:, :, None]).norm(dim=3).mean(dim=2, keepdim=True) / STEP_SCALE_M,
                told.expand(len(rssi_dbm), -1, -1),
            ],
            dim=2,
        )
        states, last_state = self.recurrent(self.input(features), state[None].contiguous())
        logits = self.policy_scale * self.head(states).unflatten(2, (len(NETWORK_NAMES), NUM_CHOICES))
        return logits, torch.cat([last_state[0], center_m[-1], told], dim=1)

    def _heard(self, rssi_dbm: Float[Tensor, "step chase sample 6"]) -> Float[Tensor, "step chase feature"]:
        """Mean powers as differences, contrasts, level and distances, the shapes, and who was heard."""
        rssi_dbm = rssi_dbm.movedim(2, 3).contiguous()
        valid = rssi_dbm.isfinite()
        level_db = (rssi_dbm - LEVEL_CENTER_DBM).clamp(-WILDEST_DB, WILDEST_DB)
        share = valid.float().mean(dim=3)
        heard = share > 0
        power = torch.where(valid, 10 ** (level_db.clamp(max=100) / 10), 0.0).mean(dim=3) / share.clamp(min=1e-3)
        tracker_db = 10 * power.clamp(min=1e-30).log10()
        mean_db = torch.where(heard, tracker_db, 0.0).sum(dim=2, keepdim=True) / heard.sum(dim=2, keepdim=True).clamp(
            min=1
        )
        tracker_db = torch.where(heard, tracker_db, mean_db)
        shape_db = torch.where(valid, level_db - tracker_db[..., None], 0.0)
        difference = (tracker_db[..., 0::2] - tracker_db[..., 1::2]) / PAIR_DIFFERENCE_SCALE_DB
        contrast = ((tracker_db[..., 0::2] + tracker_db[..., 1::2]) / 2 - mean_db) / PAIR_DIFFERENCE_SCALE_DB
        distance = 10 ** ((LEVEL_50_M_DBM - LEVEL_CENTER_DBM - tracker_db) / DECADE_DB)
        parts = [
            difference,
            contrast,
            mean_db / LEVEL_SCALE_DB,
            distance.clamp(max=MOST_DISTANCE),
            self.shape(shape_db / SHAPE_SCALE_DB).flatten(2),
            share,
        ]
        return torch.cat(parts, dim=2)


class GatedForm(Form[GatedNetwork, GatedNetwork]):
    """The same network in files and in training, but for its policy scale."""

    name = GatedNetwork.form
    file_format = "swarmchase-gated-1"
    objectives = frozenset({"counterfactual"})
    why_no_other_objective = "the form gated has no critic"
    window_samples = PAPER_WINDOW_SAMPLES
    filed = GatedNetwork

    def new(self, settings: FormSettings, generator: torch.Generator | None) -> GatedNetwork:
        """As ``Form.new``."""
        return GatedNetwork(generator, settings.policy_scale)

    def continued(self, settings: FormSettings, start: GatedNetwork) -> GatedNetwork:
        """As ``Form.continued``."""
        return start.with_policy_scale(settings.policy_scale)

    def deployed(self, trained: GatedNetwork) -> GatedNetwork:
        """As ``Form.deployed``."""
        return trained.with_policy_scale(1.0)
