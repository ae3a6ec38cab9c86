"""A vehicle: none. The receiver stands on a tripod, where it is said to be."""

from swarmchase.errors import InputError
from swarmchase.live.link.messages import Metres, TrackerMode, VehicleState
from swarmchase.live.tracker.vehicles.kind import VehicleDetails, VehicleKind


class Tripod:
    """It is where it stands, whatever it is told."""

    velocity_mps: Metres = (0.0, 0.0, 0.0)
    mode = TrackerMode.MANUAL
    position_age_s = 0.0
    state = VehicleState(is_armed=False, is_airborne=False, is_simulated=False)

    def __init__(self, position_m: Metres) -> None:
        self.position_m = position_m

    def health(self, tracker: int) -> None:
        """It has no battery."""

    def said(self) -> list[tuple[str, str]]:
        """Nothing."""
        return []

    def go_to(self, position_m: Metres) -> None:
        """It cannot."""

    def hold(self) -> None:
        """It does."""

    def update(self, now_ns: int) -> None:
        """Nothing is due."""

    def close(self) -> None:
        """Nothing is held."""


def _open(place: str, details: VehicleDetails) -> Tripod:
    if details.position_m is None:
        raise InputError("a tripod needs --position-m: it is where it stands")
    return Tripod(details.position_m)


KIND = VehicleKind(scheme="tripod", place="", open=_open)
