"""What all windows of a chase so far say of their fading: a mean and a spread for every tracker's level in each.

Samples relative to their tracker's mean power do not depend on the distance, only on the fading. One window shows
whether a tracker is in a fade where fading is slow against it; many windows show how strong the fading is, how fast,
and how far trackers fade together. This network is told nothing of that: it reads each window by itself, takes the mean
of what it has read, and reads every window anew in its light (a set encoder: Zaheer et al. 2017, Deep sets). So what it
says of the first window changes with the tenth.

A window of another number of samples than the paper's is brought to it along straight lines. A missing sample (NaN) is
interpolated between its neighbours in time; a tracker without any sample counts nowhere.
"""

import copy
from dataclasses import dataclass

import torch
from torch import nn

from ..batch.array_types import Bool, Float, Tensor
from ..observation import mean_power_dbm
from ..scenario import Scenario
from .actor_critic import PAPER_WINDOW_SAMPLES
from .fading import DEEPEST_FADE, SHAPE_SCALE_DB, interpolated
from .protocol import Form, FormSettings, HearingNetworks

OWN_FEATURES = 128
"""Of one tracker's window."""
WINDOW_FEATURES = 64
"""Of what six trackers show together in a window, and of what all windows show."""
HEAD_FEATURES = 48
LEAST_SPREAD_DB = 0.2
"""No tracker's level is known better."""
WIDEST_SPREAD_DB = 20.0
TYPICAL_SPREAD_DB = 2.0


@dataclass(frozen=True)
class HeardWindows:
    """What the network has read in windows, each by itself. It never changes."""

    own: Float[Tensor, "*window 6 head"]
    together: Float[Tensor, "*window feature"]


@dataclass(frozen=True)
class WindowsLaw:
    """What fading adds to the trackers' mean powers in dB: Gaussian, in each window with the covariance
    diag(apart^2) + together^2 1 1^T."""

    mean_db: Float[Tensor, "*window 6"]
    apart_db: Float[Tensor, "*window 6"]
    together_db: Float[Tensor, "*window"]


class WindowsNetwork(HearingNetworks):
    """Reads windows one by one (``heard``), and all of a chase together (``law``)."""

    form = "windows"
    memory_features = 0
    batch_multiple = 1
    own_features = HEAD_FEATURES
    window_features = WINDOW_FEATURES

    def __init__(self, generator: torch.Generator | None = None) -> None:
        """``generator`` draws the initial weights; without it they are left for a file to fill."""
        super().__init__()
        with torch.random.fork_rng(devices=[]):
            if generator is not None:
                torch.manual_seed(int(torch.randint(2**31, (), generator=generator)))
            self.own = nn.Sequential(
                nn.Linear(PAPER_WINDOW_SAMPLES + 1, OWN_FEATURES),
                nn.ReLU(),
                nn.Linear(OWN_FEATURES, OWN_FEATURES),
                nn.ReLU(),
            )
            self.together = nn.Sequential(
                nn.Linear(OWN_FEATURES + 2, WINDOW_FEATURES),
                nn.ReLU(),
                nn.Linear(WINDOW_FEATURES, WINDOW_FEATURES),
                nn.ReLU(),
            )
            self.everything = nn.Sequential(
                nn.Linear(WINDOW_FEATURES + 1, WINDOW_FEATURES),
                nn.ReLU(),
                nn.Linear(WINDOW_FEATURES, WINDOW_FEATURES),
                nn.ReLU(),
            )
            self.own_part = nn.Linear(OWN_FEATURES, HEAD_FEATURES)
            self.window_part = nn.Linear(2 * WINDOW_FEATURES, HEAD_FEATURES)
            self.own_head = nn.Sequential(nn.ReLU(), nn.Linear(HEAD_FEATURES, 2))
            self.together_head = nn.Sequential(
                nn.Linear(2 * WINDOW_FEATURES, HEAD_FEATURES),
                nn.ReLU(),
                nn.Linear(HEAD_FEATURES, 1),
            )

    def begin(self, scenario: Scenario, num_chases: int) -> Float[Tensor, "chase memory"]:
        """It is told nothing."""
        return torch.zeros(num_chases, 0)

    def heard(self, rssi_dbm: Float[Tensor, "window sample 6"]) -> HeardWindows:
        """Windows in dBm, each by itself."""
        rssi_dbm = rssi_dbm.float()
        valid = rssi_dbm.isfinite()
        level_db = (rssi_dbm - mean_power_dbm(rssi_dbm)[:, None]).transpose(1, 2).contiguous()
        valid = valid.transpose(1, 2)
        shape = (_resampled(interpolated(level_db, valid)) / SHAPE_SCALE_DB).clamp(min=DEEPEST_FADE)
        own = self.own(torch.cat([shape, valid.float().mean(dim=2, keepdim=True)], dim=2))
        counts = valid.any(dim=2).to(own.dtype)
        share = (counts / counts.sum(dim=1, keepdim=True).clamp(min=1))[..., None]
        average = (shape * share).sum(dim=1)
        alike = average.var(dim=1, unbiased=False, keepdim=True)
        each = (shape.var(dim=2, unbiased=False, keepdim=True) * share).sum(dim=1)
        together = self.together(torch.cat([(own * share).sum(dim=1), alike / (each + 0.01), each], dim=1))
        return HeardWindows(self.own_part(own), together)

    def law(self, heard: HeardWindows, counts: Bool[Tensor, "chase window"]) -> WindowsLaw:
        """Of all windows of each chase that count, in the light of all of them."""
        number = counts.sum(dim=1, keepdim=True).clamp(min=1).to(heard.together.dtype)
        average = (heard.together * counts[..., None]).sum(dim=1) / number
        everything = self.everything(torch.cat([average, 1 / number], dim=1))[:, None]
        window = torch.cat([heard.together, everything.expand_as(heard.together)], dim=2)
        mean, apart = self.own_head(heard.own + self.window_part(window)[:, :, None]).unbind(dim=-1)
        return WindowsLaw(SHAPE_SCALE_DB * mean, _spread_db(apart), _spread_db(self.together_head(window)[..., 0]))


class WindowsForm(Form[WindowsNetwork, WindowsNetwork]):
    """The same network in files and in training."""

    name = WindowsNetwork.form
    file_format = "swarmchase-windows-1"
    objectives = frozenset()
    why_no_other_objective = "the form windows learns without chases: swarmchase train windows"
    window_samples = None
    filed = WindowsNetwork

    def new(self, settings: FormSettings, generator: torch.Generator | None) -> WindowsNetwork:
        """As ``Form.new``."""
        return WindowsNetwork(generator)

    def continued(self, settings: FormSettings, start: WindowsNetwork) -> WindowsNetwork:
        """As ``Form.continued``."""
        return start

    def deployed(self, trained: WindowsNetwork) -> WindowsNetwork:
        """As ``Form.deployed``."""
        return copy.deepcopy(trained)


def _resampled(level_db: Float[Tensor, "window tracker sample"]) -> Float[Tensor, "window tracker 50"]:
    """As many samples as the paper's windows have, the first and the last as they were."""
    if level_db.shape[2] == PAPER_WINDOW_SAMPLES:
        return level_db
    return nn.functional.interpolate(level_db, size=PAPER_WINDOW_SAMPLES, mode="linear", align_corners=True)


def _spread_db(output: Float[Tensor, "*window"]) -> Float[Tensor, "*window"]:
    spread_db: Tensor = (TYPICAL_SPREAD_DB * output.exp()).clamp(LEAST_SPREAD_DB, WIDEST_SPREAD_DB)
    return spread_db
