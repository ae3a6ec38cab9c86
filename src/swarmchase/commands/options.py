"""Options that several commands share."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from ..scenario import Scenario

ActionChoice = Literal["sampled", "greedy"]
"""As in ``controllers``, which is slow to import: it needs torch."""


@dataclass(frozen=True, kw_only=True)
class ScenarioOptions:
    """The world of the chase: Table I of the paper, with these changes."""

    sampling_hz: float | None = None
    """F, RSSI samples a second (the paper: 10, 20, 50, 100; default 10)."""
    spatial_correlation: float | None = None
    """rho, correlation between trackers (the paper: 0.1, 0.5, 0.9; default 0.9)."""
    scenario_file: Path | None = None
    """A TOML file with any fields of the scenario; what it does not name is Table I."""

    def scenario(self) -> Scenario:
        """The scenario these options describe.

        Raises:
            InputError: a value or file that is refused.
        """
        base = Scenario() if self.scenario_file is None else Scenario.load_toml(self.scenario_file)
        given: dict[str, Any] = {"sampling_hz": self.sampling_hz, "spatial_correlation": self.spatial_correlation}
        return Scenario.from_dict(base.to_dict() | {name: value for name, value in given.items() if value is not None})
