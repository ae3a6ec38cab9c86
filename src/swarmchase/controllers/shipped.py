"""Trained controllers that come with the package: families of weights files, one file a setting of F and rho."""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..scenario import Scenario

WEIGHTS_FOLDER = Path(__file__).parent.parent / "weights"
"""A folder a family; a file's name is its setting: F10-rho0.9.safetensors."""
TRAINING_LOG = WEIGHTS_FOLDER / "paper-a3c" / "F10-rho0.9-training.parquet"
CORRELATION_STEP = 0.4
"""This much rho weighs as much as a factor of two in F: both are about a step between the paper's settings."""

_FILE_NAME = re.compile(r"F(?P<sampling_hz>[0-9.]+)-rho(?P<spatial_correlation>[0-9.]+)")


@dataclass(frozen=True)
class ShippedWeights:
    """One trained controller of a family."""

    family: str
    sampling_hz: float
    spatial_correlation: float
    path: Path

    @property
    def name(self) -> str:
        """``paper/F10-rho0.9``."""
        return f"{self.family}/{setting_name(self.sampling_hz, self.spatial_correlation)}"

    def steps_from(self, scenario: Scenario) -> float:
        """How far its setting is from a scenario's, in steps of the paper's grid."""
        octaves = abs(math.log2(scenario.sampling_hz / self.sampling_hz))
        return octaves + abs(scenario.spatial_correlation - self.spatial_correlation) / CORRELATION_STEP

    def explanation(self, scenario: Scenario) -> str | None:
        """Why this one, where the scenario's setting is not its own."""
        if self.steps_from(scenario) == 0:
            return None
        return (
            f"{self.family}: none was trained for F = {scenario.sampling_hz:g} Hz, "
            f"rho = {scenario.spatial_correlation:g}; using that of F = {self.sampling_hz:g} Hz, "
            f"rho = {self.spatial_correlation:g}, the nearest (a factor of two in F counts as much as "
            f"{CORRELATION_STEP:g} in rho)"
        )


def setting_name(sampling_hz: float, spatial_correlation: float) -> str:
    """``F10-rho0.9``."""
    return f"F{sampling_hz:g}-rho{spatial_correlation:g}"


def shipped_families() -> dict[str, list[ShippedWeights]]:
    """The trained controllers by the name of their family."""
    families: dict[str, list[ShippedWeights]] = {}
    for path in sorted(WEIGHTS_FOLDER.glob("*/*.safetensors")):
        setting = _FILE_NAME.fullmatch(path.stem)
        if setting is not None:
            sampling_hz, correlation = float(setting["sampling_hz"]), float(setting["spatial_correlation"])
            family = path.parent.name
            families.setdefault(family, []).append(ShippedWeights(family, sampling_hz, correlation, path))
    return families


def chosen_weights(name: str, scenario: Scenario) -> ShippedWeights | None:
    """The family's controller trained nearest to the scenario's F and rho; None where there is no such family.

    Of two as near it is the one trained in the harder setting (higher F, then lower rho): it expects less of a window.
    """
    family = shipped_families().get(name)
    if family is None:
        return None
    return min(
        family,
        key=lambda weights: (round(weights.steps_from(scenario), 9), -weights.sampling_hz, weights.spatial_correlation),
    )


def training_log() -> list[dict[str, Any]]:
    """The chases of the training that made ``paper-a3c`` for F = 10 Hz, rho = 0.9, as in a run's log: Fig. 4's data."""
    import pyarrow.parquet as pq

    return pq.read_table(TRAINING_LOG).to_pylist()  # type: ignore[no-any-return]
