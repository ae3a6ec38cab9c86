"""From distance to RSSI: path loss (Eqs. 1-2) and correlated Rician fading with Jakes Doppler (Eqs. 3-5).

For tracker u, with path loss L(d_u) and fading h_u of unit mean power,

    rssi_u(t) = P_tx - L(d_u) + 20 log10 |h_u(t)|                                          [dBm]
    h_u(t)    = sqrt(K / (K + 1)) los_u + sqrt(1 / (K + 1)) z_u(t)
    E[z_u(t) z_v*(t + tau)] = C_uv J0(2 pi f_d tau),    C = 1 on the diagonal and rho off it

The correlation acts on the scattered part z alone; the line of sight is added after it, so that K and the mean power
are the same at every tracker. Fading is held as [chase, tracker, part, sample], part 0 in phase and 1 in quadrature.
What draws z has a file each: ``drawn_windows``, ``running_process`` and ``in_flight``.
"""

import math
from typing import Protocol, TypeVar, runtime_checkable

import torch

from ..batch.array_types import Float, Tensor
from ..batch.streams import ChaseKey, ChaseStreams, Purpose
from ..scenario import NUM_TRACKERS, Scenario

DEEPEST_FADE_DB = -200.0
"""Fading is never reported deeper than this, so that a sample is finite even if |h| underflows."""

State = TypeVar("State")


@runtime_checkable
class Fading(Protocol[State]):
    """Correlated Rician fading of a batch of chases, call by call.

    Its state is a batch of chases (``batch.selection``). Every chase draws from its own stream, so batches are free to
    change from call to call.
    """

    heeds_motion: bool
    """Whether ``gain`` looks at ``moved_m``."""

    def begin(self, keys: list[ChaseKey], purpose: Purpose = "fading") -> State:
        """The fading of these chases before their first sample, from the streams of this purpose."""
        ...

    def gain(
        self,
        state: State,
        time_s: Float[Tensor, "chase sample"],
        moved_m: Float[Tensor, "chase sample tracker"] | None = None,
    ) -> tuple[Float[Tensor, "chase tracker 2 sample"], State]:
        """h at these times, float32.

        Args:
            state: the fading as the call before left it.
            time_s: since the chase began, float64; it never goes back, within a call or from one to the next.
            moved_m: length of the way between target and tracker since the sample before, or since the last one of
                the call before: how far each moved as seen from the other, float64. None: nobody moves.
        """
        ...


def window_time_s(scenario: Scenario, begin_s: Float[Tensor, "chase"]) -> Float[Tensor, "chase sample"]:
    """When the samples of windows that begin at these times are taken: L of them, 1 / F apart, float64."""
    since_begin_s = torch.arange(scenario.window_samples, dtype=torch.float64) / scenario.sampling_hz
    return begin_s[:, None] + since_begin_s.to(begin_s.device)


def fading_db(fading: Float[Tensor, "chase tracker 2 sample"]) -> Float[Tensor, "chase tracker sample"]:
    """20 log10 |h|, at least ``DEEPEST_FADE_DB``."""
    power = fading[:, :, 0].square().addcmul_(fading[:, :, 1], fading[:, :, 1])
    return power.clamp_min_(10 ** (DEEPEST_FADE_DB / 10)).log10_().mul_(10)


def amplitudes(scenario: Scenario) -> tuple[float, float]:
    """(line of sight, scattered part) of a fading of unit mean power: sqrt(K / (K + 1)) and sqrt(1 / (K + 1))."""
    return math.sqrt(scenario.rician_k / (scenario.rician_k + 1)), math.sqrt(1 / (scenario.rician_k + 1))


def spatial_mixing(spatial_correlation: float) -> tuple[float, float]:
    """(own, shared) of the symmetric square root ``own I + shared 1 1^T`` of C, uniform correlation rho (Eq. 4)."""
    own = math.sqrt(1 - spatial_correlation)
    shared = (math.sqrt(1 + (NUM_TRACKERS - 1) * spatial_correlation) - own) / NUM_TRACKERS
    return own, shared


def mixed(
    normals: Float[Tensor, "chase tracker 2 k"], mixing: tuple[float, float]
) -> Float[Tensor, "chase tracker 2 k"]:
    """The matrix square root of C (Eq. 3) applied across trackers."""
    own, shared = mixing
    return torch.add(normals.sum(dim=1, keepdim=True).mul_(shared), normals, alpha=own)


def drawn_los_phase_rad(streams: ChaseStreams) -> Float[Tensor, "chase tracker"]:
    """A line-of-sight phase for each tracker, uniform on the circle, float64."""
    return 2 * math.pi * streams.uniform(NUM_TRACKERS)


def with_line_of_sight(
    scattered: Float[Tensor, "chase tracker 2 sample"],
    los_amplitude: float,
    los_phase_rad: Float[Tensor, "chase tracker"] | None,
) -> Float[Tensor, "chase tracker 2 sample"]:
    """The scattered part with the line of sight added in place; without phases it is in phase at all trackers."""
    if los_phase_rad is None:
        scattered[:, :, 0].add_(los_amplitude)
        return scattered
    scattered[:, :, 0].add_((los_amplitude * los_phase_rad.cos()).float()[:, :, None])
    scattered[:, :, 1].add_((los_amplitude * los_phase_rad.sin()).float()[:, :, None])
    return scattered
