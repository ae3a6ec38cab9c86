"""What a window's shape says of its fading: how far the mean power is from what path loss alone would give.

Samples relative to their tracker's mean power do not depend on the distance, only on the fading. Where fading is slow
against the window, slope and curvature show whether a tracker is in a fade: at 100 Hz the standard deviation of the
mean power falls from 2.6 dB to 1.6 dB when what this network expects is taken off. Trackers fade together, so each is
judged beside what all six show.

It is told F and rho. A missing sample (NaN) is interpolated between its neighbours in time; a tracker without any
sample counts nowhere.
"""

import copy
import hashlib
import math

import torch
from torch import nn

from ..batch.array_types import Bool, Float, Tensor
from ..observation import mean_power_dbm
from ..scenario import NUM_TRACKERS, Scenario
from .actor_critic import PAPER_WINDOW_SAMPLES
from .protocol import ExpectingNetwork, Form, FormSettings

SHAPE_FEATURES = 128
SHAPE_SCALE_DB = 5.0
DEEPEST_FADE = -8.0
"""Samples are cut off here, in units of ``SHAPE_SCALE_DB`` below their mean: a null has no depth of its own."""
TOLD_FEATURES = 2


class FadingNetwork(ExpectingNetwork):
    """The expected fading of each tracker's mean power in a window."""

    form = "fading"
    memory_features = TOLD_FEATURES
    batch_multiple = 16

    def __init__(self, generator: torch.Generator | None = None) -> None:
        """``generator`` draws the initial weights; without it they are left for a file to fill."""
        super().__init__()
        with torch.random.fork_rng(devices=[]):
            if generator is not None:
                torch.manual_seed(int(torch.randint(2**31, (), generator=generator)))
            self.own = nn.Sequential(
                nn.Linear(PAPER_WINDOW_SAMPLES + TOLD_FEATURES, SHAPE_FEATURES),
                nn.ReLU(),
                nn.Linear(SHAPE_FEATURES, SHAPE_FEATURES),
                nn.ReLU(),
            )
            self.together = nn.Sequential(
                nn.Linear(2 * SHAPE_FEATURES, SHAPE_FEATURES),
                nn.ReLU(),
                nn.Linear(SHAPE_FEATURES, 1),
            )

    def begin(self, scenario: Scenario, num_chases: int) -> Float[Tensor, "chase memory"]:
        """All it carries through a chase: what it is told of the scenario."""
        told = torch.tensor([math.log10(scenario.sampling_hz) - 1.5, scenario.spatial_correlation - 0.5])
        return told.expand(num_chases, -1).clone()

    def forward(
        self, rssi_dbm: Float[Tensor, "chase sample 6"], told: Float[Tensor, "chase memory"]
    ) -> Float[Tensor, "chase 6"]:
        """The fading in dB that is to be expected in each tracker's mean power."""
        valid = rssi_dbm.isfinite()
        heard = valid.any(dim=1)
        level_db = (rssi_dbm - mean_power_dbm(rssi_dbm)[:, None]).transpose(1, 2).contiguous()
        shape = (interpolated(level_db, valid.transpose(1, 2)) / SHAPE_SCALE_DB).clamp(min=DEEPEST_FADE)
        own = self.own(torch.cat([shape, told[:, None].expand(-1, NUM_TRACKERS, -1)], dim=2))
        share = heard.to(own.dtype) / heard.sum(dim=1, keepdim=True).clamp(min=1)
        everyone = (own * share[..., None]).sum(dim=1, keepdim=True).expand_as(own)
        expected_db: Tensor = self.together(torch.cat([own, everyone], dim=2))
        return expected_db[..., 0]


class CorrectedPower:
    """The mean power of each tracker in a window less the fading that its shape lets expect: a ``WindowPower``."""

    def __init__(self, network: ExpectingNetwork, scenario: Scenario) -> None:
        self._network = network.eval()
        self._scenario = scenario
        self._content = _content_sha256(network), scenario.sampling_hz, scenario.spatial_correlation

    def __eq__(self, other: object) -> bool:
        """Whether the two give the same levels, by what the networks held when they came here."""
        return isinstance(other, CorrectedPower) and self._content == other._content

    def __hash__(self) -> int:
        return hash(self._content)

    def __call__(self, rssi_dbm: Float[Tensor, "chase sample tracker"]) -> Float[Tensor, "chase tracker"]:
        """In dBm; NaN where a tracker has no sample."""
        num_chases = len(rssi_dbm)
        missing = -num_chases % self._network.batch_multiple
        window_dbm = torch.cat([rssi_dbm.float(), rssi_dbm[:1].float().expand(missing, -1, -1)])
        with torch.inference_mode():
            expected_db: Tensor = self._network(window_dbm, self._network.begin(self._scenario, len(window_dbm)))
        return mean_power_dbm(rssi_dbm) - expected_db[:num_chases].clone()


class FadingForm(Form[FadingNetwork, FadingNetwork]):
    """The same network in files and in training."""

    name = FadingNetwork.form
    file_format = "swarmchase-fading-1"
    objectives = frozenset({"fading"})
    why_no_other_objective = "the objective fading is for the form fading alone"
    window_samples = PAPER_WINDOW_SAMPLES
    filed = FadingNetwork

    def new(self, settings: FormSettings, generator: torch.Generator | None) -> FadingNetwork:
        """As ``Form.new``."""
        return FadingNetwork(generator)

    def continued(self, settings: FormSettings, start: FadingNetwork) -> FadingNetwork:
        """As ``Form.continued``."""
        return start

    def deployed(self, trained: FadingNetwork) -> FadingNetwork:
        """As ``Form.deployed``."""
        return copy.deepcopy(trained)


def _content_sha256(network: ExpectingNetwork) -> str:
    """Of its class and its parameters."""
    digest = hashlib.sha256(type(network).__qualname__.encode())
    for name, tensor in network.state_dict().items():
        digest.update(name.encode())
        digest.update(tensor.cpu().numpy().tobytes())
    return digest.hexdigest()


def interpolated(
    level_db: Float[Tensor, "chase tracker sample"], valid: Bool[Tensor, "chase tracker sample"]
) -> Float[Tensor, "chase tracker sample"]:
    """Missing samples on a straight line between the valid ones before and after, or as the only one there is; 0 where
    there is none."""
    if valid.all():
        return level_db
    num_samples = level_db.shape[2]
    sample = torch.arange(num_samples, device=level_db.device).expand(valid.shape)
    before = torch.where(valid, sample, -1).cummax(dim=2).values
    after = torch.where(valid, sample, num_samples).flip(2).cummin(dim=2).values.flip(2)
    first, last = torch.where(before < 0, after, before), torch.where(after == num_samples, before, after)
    first, last = (index.clamp(0, num_samples - 1) for index in (first, last))
    level_db = torch.where(valid, level_db, 0.0)
    share = ((sample - first) / (last - first).clamp(min=1)).clamp(0, 1)
    level_before_db, level_after_db = level_db.gather(2, first), level_db.gather(2, last)
    return level_before_db + share.to(level_db.dtype) * (level_after_db - level_before_db)
