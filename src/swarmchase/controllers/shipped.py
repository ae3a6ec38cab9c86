"""Trained controllers that come with the package: families of weights files, one for each setting of F and rho, or one
for all settings."""

import math
import re
from dataclasses import dataclass
from pathlib import Path

from ..scenario import Scenario

WEIGHTS_FOLDER = Path(__file__).parent.parent / "weights"
"""A folder a family; a file's name is its setting: F10-rho0.9.safetensors, all-settings.safetensors, or
all-channels.safetensors. In a wheel they are compressed, and of some there is the name alone (hatch_build.py)."""
LEFT_OUT = ".left-out"
"""Ends the name of a file that the wheel does not hold."""
ALL_SETTINGS = "all-settings"
ALL_CHANNELS = "all-channels"
"""Of a controller that is not told F and rho."""
TRAINED_HZ, TRAINED_CORRELATION = (10.0, 100.0), (0.1, 0.9)
"""Between these the controllers for all settings were trained, which are told F and rho."""
CORRELATION_STEP = 0.4
"""This much rho weighs as much as a factor of two in F: both are about a step between the paper's settings."""

_FILE_NAME = re.compile(r"F(?P<sampling_hz>[0-9.]+)-rho(?P<spatial_correlation>[0-9.]+)")


@dataclass(frozen=True)
class ShippedWeights:
    """One trained controller of a family."""

    family: str
    setting: tuple[float, float] | None
    """F in hertz and rho that it was trained for; None for one that was trained for many."""
    path: Path

    @property
    def name(self) -> str:
        """``paper/F10-rho0.9``."""
        return f"{self.family}/{_stem(self.path)}"

    @property
    def is_here(self) -> bool:
        """Whether this installation holds it."""
        return self.path.suffix != LEFT_OUT

    @property
    def where_it_is(self) -> str:
        """What to do where it is not here."""
        path = f"src/swarmchase/weights/{self.name}.safetensors"
        return (
            f"the weights {self.name} are not in this installation, which was made from a wheel: install from a clone "
            f"with pip install -e . or give the clone's file as the controller: {path}"
        )

    def steps_from(self, scenario: Scenario) -> float:
        """How far its setting is from a scenario's, in steps of the paper's grid."""
        if self.setting is None:
            return 0.0
        sampling_hz, spatial_correlation = self.setting
        octaves = abs(math.log2(scenario.sampling_hz / sampling_hz))
        return octaves + abs(scenario.spatial_correlation - spatial_correlation) / CORRELATION_STEP

    def explanation(self, scenario: Scenario) -> str | None:
        """Why this one, where the scenario's setting is not its own."""
        if _stem(self.path) == ALL_CHANNELS:
            return None
        asked = f"F = {scenario.sampling_hz:g} Hz, rho = {scenario.spatial_correlation:g}"
        if self.setting is None:
            if _lies_in(scenario.sampling_hz, TRAINED_HZ) and _lies_in(
                scenario.spatial_correlation, TRAINED_CORRELATION
            ):
                return None
            return (
                f"{self.family}: trained for F = {TRAINED_HZ[0]:g} to {TRAINED_HZ[1]:g} Hz, "
                f"rho = {TRAINED_CORRELATION[0]:g} to {TRAINED_CORRELATION[1]:g}; {asked} lies outside"
            )
        if self.steps_from(scenario) == 0:
            return None
        sampling_hz, spatial_correlation = self.setting
        return (
            f"{self.family}: none was trained for {asked}; using that of F = {sampling_hz:g} Hz, "
            f"rho = {spatial_correlation:g}, the nearest (a factor of two in F counts as much as "
            f"{CORRELATION_STEP:g} in rho)"
        )


def setting_name(sampling_hz: float, spatial_correlation: float) -> str:
    """``F10-rho0.9``."""
    return f"F{sampling_hz:g}-rho{spatial_correlation:g}"


def shipped_families() -> dict[str, list[ShippedWeights]]:
    """The trained controllers by the name of their family."""
    families: dict[str, list[ShippedWeights]] = {}
    for path in sorted(WEIGHTS_FOLDER.glob("*/*.safetensors*")):
        setting = _FILE_NAME.fullmatch(_stem(path))
        family = path.parent.name
        if setting is not None:
            own = float(setting["sampling_hz"]), float(setting["spatial_correlation"])
            families.setdefault(family, []).append(ShippedWeights(family, own, path))
        elif _stem(path) in (ALL_SETTINGS, ALL_CHANNELS):
            families.setdefault(family, []).append(ShippedWeights(family, None, path))
    return families


def chosen_weights(name: str, scenario: Scenario) -> ShippedWeights | None:
    """The family's controller for all settings or channels, or the one trained nearest to the scenario's F and rho.

    None where there is no such family.

    Of two as near it is the one trained in the harder setting (higher F, then lower rho): it expects less of a window.
    """
    family = shipped_families().get(name)
    if family is None:
        return None

    def order(weights: ShippedWeights) -> tuple[float, float, float]:
        sampling_hz, spatial_correlation = weights.setting or (0.0, 0.0)
        return round(weights.steps_from(scenario), 9), -sampling_hz, spatial_correlation

    return min(family, key=order)


def _stem(path: Path) -> str:
    return path.name.partition(".safetensors")[0]


def _lies_in(value: float, bounds: tuple[float, float]) -> bool:
    return bounds[0] <= value <= bounds[1]
