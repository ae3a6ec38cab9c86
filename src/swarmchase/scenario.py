"""Every constant of the world: Section II and Table I of the paper, unit in the name, source beside it.

A scenario is immutable. ``paper_scenario()`` is Table I exactly; any field can be given by keyword, and a bad
value is refused with the field's name, the value and the allowed range.
"""

import dataclasses
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from .errors import InputError
from .files import write_text_atomically
from .plug_ins import NamesWith
from .ranges import AT_LEAST_ONE, AT_LEAST_ZERO, FINITE, POSITIVE, SHARE, Range, checked_number, require_choice, shown
from .reading import Bounds, read_toml

SPEED_OF_LIGHT_MPS = 299_792_458.0

LosPhase = Literal["common", "independent"]
CONTINUITIES = ("independent", "continuous", "in_flight")
Pace = Literal["stop_and_listen", "listen_in_flight"]

NUM_TRACKERS = 6
"""Two on each of three axes (Section II.A). It is geometry, not a setting."""
MOST_WINDOW_SAMPLES = 10_000
"""Two hundred times the paper's; a typing error is not to ask for all the memory that there is."""
MOST_CHOICES = 1_000
"""Of spacings, and of displacements."""
FILE_BOUNDS = Bounds(most_bytes=64 * 1024, most_values=10_000, is_finite=False)
"""Of a scenario's TOML file. The ranges refuse what is not finite, by the field's name."""

SHIPPED_SCENARIOS = ("paper", "flight", "field", "rough")
"""Each a TOML file in ``scenarios/``; each but the first has what the one before has, and more."""


def doppler_spread_from_speed_hz(relative_speed_mps: float, carrier_frequency_hz: float) -> float:
    """Eq. (5), f_d = v / c * f_c: 0.1 m/s at 3 GHz gives the 1 Hz of Table I."""
    return relative_speed_mps / SPEED_OF_LIGHT_MPS * carrier_frequency_hz


def _constant(default: Any, allowed: Any, symbol: str, source: str, meaning: str) -> Any:
    return field(default=default, metadata={"allowed": allowed, "symbol": symbol, "source": source, "help": meaning})


def _departure(default: Any, allowed: Any, source: str, meaning: str) -> Any:
    """A field that the paper's world does not have: its default is the paper's world, and is not written to files."""
    about = {"allowed": allowed, "symbol": "-", "source": source, "help": meaning, "departs_from_paper": True}
    return field(default=default, metadata=about)


@dataclass(frozen=True, kw_only=True, repr=False)
class Scenario:
    """The world of one chase. Each field's metadata holds its symbol, source, meaning and allowed range.

    Printed, it shows F, rho and what else is not as in the paper:

    >>> Scenario(sampling_hz=20.0, shadowing_db=4.0)
    Scenario(sampling_hz=20.0, spatial_correlation=0.9, shadowing_db=4.0)

    Raises:
        InputError: a value of the wrong type or outside its range.
    """

    transmit_power_dbm: float = _constant(23.0, FINITE, "P_tx", "Table I", "Transmit power of the target.")
    reference_distance_m: float = _constant(
        1.0, POSITIVE, "d_0", "Table I", "Reference distance of the path loss; nearer distances count as this one."
    )
    reference_path_loss_db: float = _constant(30.0, FINITE, "L_0", "Table I", "Path loss at the reference distance.")
    path_loss_exponent: float = _constant(2.6, POSITIVE, "n", "Table I", "Path loss exponent.")
    rician_k: float = _constant(
        3.0, AT_LEAST_ZERO, "K", "Table I", "Rician K-factor, linear: line-of-sight power over scattered power."
    )
    doppler_spread_hz: float = _constant(
        1.0, Range(0.0, 1000.0), "f_d", "Table I, Eq. (5)", "Doppler spread: 0.1 m/s at 3 GHz."
    )
    window_samples: int = _constant(
        50, Range(1.0, MOST_WINDOW_SAMPLES), "L", "Table I", "RSSI samples a tracker reports in one window."
    )
    sampling_hz: float = _constant(
        10.0, POSITIVE, "F", "Section IV", "Sampling frequency; the paper uses 10, 20, 50 and 100."
    )
    spatial_correlation: float = _constant(
        0.9,
        SHARE,
        "rho",
        "Eq. (4)",
        "Correlation of the scattered parts of two trackers; the paper uses 0.1, 0.5 and 0.9.",
    )
    los_phase: LosPhase = _constant(  # noqa: RUF009
        "common", get_args(LosPhase), "-", "choice", "Line-of-sight phase: one for all trackers, or one drawn for each."
    )
    continuity: str = _constant(
        "independent",
        NamesWith(CONTINUITIES, "fading"),
        "-",
        "choice",
        "Fading from one window to the next: drawn anew (independent), one running process (continuous), one that runs "
        "as fast as they fly (in_flight), or another package's.",
    )
    start_distance_m: float = _constant(
        100.0, POSITIVE, "|O_0 - U|", "Section IV", "Distance of the target at the start."
    )
    success_radius_m: float = _constant(
        2.0, POSITIVE, "th", "Table I", "The chase succeeds when the centre is at most this far from the target."
    )
    max_movements: int = _constant(
        500, AT_LEAST_ONE, "MAX_STEPS", "Table I", "Movements after which a chase has failed."
    )
    spacing_choices_m: tuple[float, ...] = _constant(
        (1.0, 2.0, 3.0, 4.0, 5.0), POSITIVE, "A^d", "Section III.A", "Spacings the controller can choose."
    )
    displacement_choices_m: tuple[float, ...] = _constant(
        (-4.0, -2.0, 0.0, 2.0, 4.0),
        FINITE,
        "A^x, A^y, A^z",
        "Section III.A",
        "Displacements the controller can choose on each axis.",
    )
    initial_spacing_m: float = _constant(5.0, POSITIVE, "d_0", "choice", "Spacing while the first window is heard.")
    receiver_offset_db: float = _constant(
        0.0, Range(0.0, 100.0), "-", "choice", "Each receiver is off by a constant, drawn from plus or minus this."
    )
    missing_sample_share: float = _constant(0.0, SHARE, "-", "choice", "Share of the samples that get lost.")
    silent_trackers: int = _constant(
        0, Range(0.0, float(NUM_TRACKERS)), "-", "choice", "Trackers, drawn for each chase, that report nothing."
    )
    tracker_speed_mps: float = _constant(5.0, POSITIVE, "v", "Section IV", "Speed of the swarm between two windows.")

    # What the paper's world does not have. Off, or as in the paper, unless a scenario says otherwise.

    pace: Pace = _departure(  # noqa: RUF009
        "stop_and_listen", get_args(Pace), "choice", "Trackers hear a window after they have arrived, or on their way."
    )
    decision_s: float = _departure(
        0.5, Range(0.01, 60.0), "motion prototype", "Time between two decisions of trackers that listen on their way."
    )
    tracker_acceleration_mps2: float | None = _departure(
        None, POSITIVE, "choice", "Most that the swarm's velocity changes in a second; None for at once."
    )
    carrier_hz: float = _departure(3e9, POSITIVE, "Section II.C", "Carrier frequency: Doppler of what flies.")
    behaviour: str = _departure("hover", None, "choice", "What the target does; world/behaviours has a file of each.")
    target_speed_mps: float = _departure(0.0, Range(0.0, 100.0), "choice", "Speed of a target that flies.")
    target_acceleration_mps2: float = _departure(
        4.0, POSITIVE, "motion prototype", "Most that the target's velocity changes in a second."
    )
    alert_distance_m: float | None = _departure(
        None, POSITIVE, "choice", "From here on the target notices the swarm; None for always."
    )
    follow_s: float = _departure(
        0.0, Range(0.0, 3600.0), "choice", "So long a chase goes on after the target was reached."
    )
    farthest_start_m: float | None = _departure(
        None, POSITIVE, "choice", "The start is drawn between start_distance_m and this; None for start_distance_m."
    )
    highest_elevation_deg: float = _departure(
        90.0, Range(0.0, 90.0), "choice", "The target starts at most so far above or below the swarm's horizon."
    )
    start_altitude_m: float = _departure(
        50.0, FINITE, "motion prototype", "Altitude of the swarm's centre at the start."
    )
    lowest_altitude_m: float | None = _departure(
        None, FINITE, "choice", "The target flies no lower; None for no limit."
    )
    highest_altitude_m: float | None = _departure(
        None, FINITE, "choice", "The target flies no higher; None for no limit."
    )
    transmit_power_error_db: float = _departure(
        0.0, Range(0.0, 100.0), "choice", "The transmit power is off by a constant, drawn from plus or minus this."
    )
    path_loss_exponent_error: float = _departure(
        0.0, Range(0.0, 10.0), "choice", "The exponent is off by a constant, drawn from plus or minus this."
    )
    shadowing_db: float = _departure(
        0.0, Range(0.0, 40.0), "Gudmundson 1991", "Standard deviation of log-normal shadowing."
    )
    shadowing_distance_m: float = _departure(
        20.0, POSITIVE, "Gudmundson 1991", "Its correlation falls to 1 / e over this distance."
    )
    shadowing_common_share: float = _departure(
        0.5, SHARE, "choice", "Share of its variance that all trackers have in common: what surrounds the target."
    )
    ground_reflection: float = _departure(
        0.0, SHARE, "two-ray model", "Amplitude of the ray that the ground reflects over that of the direct one."
    )
    transmit_duty: float = _departure(
        1.0,
        Range(0.0, 1.0, low_is_allowed=False),
        "choice",
        "Share of the time in which the target transmits, in frames.",
    )
    frame_s: float = _departure(0.2, POSITIVE, "choice", "Mean length of a frame of a target that transmits in frames.")
    silence_s: float = _departure(0.0, Range(0.0, 3600.0), "choice", "Length of the target's long silences.")
    between_silences_s: float = _departure(60.0, POSITIVE, "choice", "Mean time from one long silence to the next.")
    silence_at_s: float | None = _departure(
        None, AT_LEAST_ZERO, "choice", "When the target's only long silence begins; None for several, at random."
    )
    missing_burst_s: float = _departure(
        0.0, Range(0.0, 3600.0), "choice", "Mean length of the gaps that missing samples come in; 0 for one by one."
    )
    receiver_step_db: float = _departure(0.0, Range(0.0, 20.0), "field recordings", "Steps in which receivers report.")
    receiver_floor_dbm: float | None = _departure(
        None, FINITE, "field recordings", "Receivers report nothing that is weaker; None for no floor."
    )
    receiver_ceiling_dbm: float | None = _departure(
        None, FINITE, "field recordings", "Receivers report nothing higher than this: saturation; None for none."
    )
    wrong_trackers: int = _departure(
        0, Range(0.0, float(NUM_TRACKERS)), "field recordings", "Trackers, drawn for each chase, that are off by 20 dB."
    )
    stuck_trackers: int = _departure(
        0, Range(0.0, float(NUM_TRACKERS)), "field recordings", "Trackers, drawn for each chase, whose level stays."
    )
    garbage_share: float = _departure(
        0.0, SHARE, "field recordings", "Share of the samples that are the error values of real receivers."
    )

    def __post_init__(self) -> None:
        for constant in dataclasses.fields(self):
            value = _checked(constant, getattr(self, constant.name))
            object.__setattr__(self, constant.name, value)

    def __repr__(self) -> str:
        shown_fields = [
            f"{constant.name}={value!r}"
            for constant in dataclasses.fields(self)
            for value in (getattr(self, constant.name),)
            if constant.name in ("sampling_hz", "spatial_correlation") or value != constant.default
        ]
        return f"Scenario({', '.join(shown_fields)})"

    @property
    def window_s(self) -> float:
        """Time to hear one window, L / F (Section IV, tau(M, F))."""
        return self.window_samples / self.sampling_hz

    @property
    def departures(self) -> list[str]:
        """The fields that the paper's world does not have, and that are not as in it."""
        return [
            constant.name
            for constant in dataclasses.fields(self)
            if "departs_from_paper" in constant.metadata and getattr(self, constant.name) != constant.default
        ]

    @property
    def samples_a_decision(self) -> int:
        """RSSI samples of a tracker that a controller gets to see at once: L, or in flight those of an interval."""
        if self.pace == "stop_and_listen":
            return self.window_samples
        return math.floor(self.decision_s * self.sampling_hz + 1e-9)

    @property
    def is_told_in_seconds(self) -> bool:
        """Whether a chase is measured by the clock; the paper's are by movements."""
        return self.pace != "stop_and_listen" or self.behaviour != "hover"

    def to_dict(self) -> dict[str, Any]:
        """The fields as JSON and TOML can hold them; of those that the paper's world does not have, what departs from
        it.
        """
        departures = self.departures
        return {
            constant.name: list(value) if isinstance(value, tuple) else value
            for constant in dataclasses.fields(self)
            if "departs_from_paper" not in constant.metadata or constant.name in departures
            for value in (getattr(self, constant.name),)
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "Scenario":
        """The scenario with these fields; what is not named keeps its default.

        Raises:
            InputError: an unknown field, or a value that is refused.
        """
        known = {constant.name: constant for constant in dataclasses.fields(cls)}
        unknown = sorted(set(values) - set(known))
        if unknown:
            raise InputError(f"scenario has no field {shown(unknown[0])}; its fields are {', '.join(sorted(known))}")
        return cls(**{name: _checked(known[name], value) for name, value in values.items()})

    def save_toml(self, path: Path) -> None:
        """Write every field to a TOML file, whole or not at all."""
        lines = [f"{name} = {toml_value(value)}" for name, value in self.to_dict().items()]
        write_text_atomically(path, "\n".join(lines) + "\n")

    @classmethod
    def load_toml(cls, path: Path) -> "Scenario":
        """Read what ``save_toml`` wrote, or a file with only the fields that differ from Table I.

        Raises:
            InputError: no such file, not TOML, or a field that is refused.
        """
        return cls.from_dict(read_toml(path, "scenario", FILE_BOUNDS))


def load_scenario(name_or_path: str | Path) -> Scenario:
    """A shipped scenario by its name, or that of a TOML file.

    Raises:
        InputError: neither is there, or the file is refused.
    """
    if name_or_path in SHIPPED_SCENARIOS:
        return Scenario.load_toml(Path(__file__).parent / "scenarios" / f"{name_or_path}.toml")
    path = Path(name_or_path)
    if not path.exists() and not path.suffix:
        names = ", ".join(SHIPPED_SCENARIOS)
        raise InputError(f"no scenario {shown(str(name_or_path))}; shipped are {names}, any other is a TOML file")
    return Scenario.load_toml(path)


def paper_scenario(**changes: Any) -> Scenario:
    """Table I of the paper, with the named fields changed (usually ``sampling_hz`` and ``spatial_correlation``).

    >>> scenario = paper_scenario(sampling_hz=100, spatial_correlation=0.5)
    >>> scenario
    Scenario(sampling_hz=100.0, spatial_correlation=0.5)
    >>> scenario.window_s
    0.5
    >>> paper_scenario(spatial_correlation=1.5)
    Traceback (most recent call last):
    swarmchase.errors.InputError: spatial_correlation = 1.5 is refused: allowed is between 0 and 1

    Raises:
        InputError: no such field, or a value of the wrong type or outside its range.
    """
    return Scenario.from_dict(changes)


def _checked(constant: "dataclasses.Field[Any]", value: Any) -> Any:
    """The value in its field's own type, or a refusal with name, value and range."""
    allowed = constant.metadata["allowed"]
    value = tuple(value) if isinstance(value, list) else value
    if value is None and constant.default is None:
        return None
    if allowed is None:
        if not isinstance(value, str):
            raise InputError(f"{constant.name} = {shown(value)} is refused: allowed is a name")
        return value
    if isinstance(allowed, Range):
        if isinstance(constant.default, tuple):
            if not isinstance(value, tuple) or not 0 < len(value) <= MOST_CHOICES:
                raise InputError(
                    f"{constant.name} = {shown(value)} is refused: a list of 1 to {MOST_CHOICES} numbers, "
                    f"each {allowed.text}, is needed"
                )
            return tuple(checked_number(constant.name, entry, allowed, whole=False) for entry in value)
        return checked_number(constant.name, value, allowed, whole=isinstance(constant.default, int))
    require_choice(constant.name, value, allowed)
    return value


def toml_value(value: Any) -> str:
    """A text, number, truth value or sequence of them as TOML writes it."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(toml_value(entry) for entry in value)}]"
    # In these two TOML is like JSON.
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str | bool) else repr(value)
