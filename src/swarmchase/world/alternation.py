"""What is on and off by turns: a target that transmits in frames, gaps in what arrives.

Both last for times that are distributed exponentially, so that what comes depends on what is and on nothing before it
(a Markov chain in continuous time). With the share p of the time on and the mean length m of being on, after a time t

    P(on | on) = p + (1 - p) exp(-t / (m (1 - p))),    P(on | off) = p (1 - exp(-t / (m (1 - p))))
"""

from dataclasses import dataclass

import torch

from ..batch.array_types import Bool, Float, Tensor

SHORTEST_S = 1e-9
"""What is always on is off for no time at all."""


@dataclass(frozen=True)
class AlternationState:
    """As the last sample found it."""

    is_on: Bool[Tensor, "chase item"]
    """Of several that alternate independently."""
    time_s: Float[Tensor, "chase"]
    """Of that sample, float64."""


class Alternation:
    """On for a share of the time, each time for a mean length."""

    def __init__(self, share: float, mean_on_s: float) -> None:
        self._share = share
        self._forgets_s = max(mean_on_s * (1 - share), SHORTEST_S)

    def begin(self, uniform: Float[Tensor, "chase item"]) -> AlternationState:
        """At time 0, as found at any time. ``uniform``: drawn from [0, 1)."""
        return AlternationState(uniform < self._share, torch.zeros(len(uniform), dtype=torch.float64).to(uniform))

    def at(
        self,
        state: AlternationState,
        time_s: Float[Tensor, "chase sample"],
        uniform: Float[Tensor, "chase sample item"],
    ) -> tuple[Bool[Tensor, "chase sample item"], AlternationState]:
        """Whether it is on at each of these times, which never go back. ``uniform``: drawn from [0, 1)."""
        remembers = torch.exp(time_s.diff(dim=1, prepend=state.time_s[:, None]) / -self._forgets_s)[:, :, None]
        turns_on = uniform < self._share * (1 - remembers)
        turns_off = uniform >= self._share + (1 - self._share) * remembers
        # What neither turns on nor off stays as the last one that did: the sample of that number, counted from 1.
        number = torch.arange(1, time_s.shape[1] + 1, device=time_s.device)[None, :, None]
        last_turn = torch.where(turns_on | turns_off, number, 0).cummax(dim=1).values
        is_on = torch.cat([state.is_on[:, None], turns_on], dim=1).gather(1, last_turn)
        return is_on, AlternationState(is_on[:, -1], time_s[:, -1].clone())
