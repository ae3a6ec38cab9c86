"""What a vehicle that fails, or lies, makes of its commands and of its place."""

from collections.abc import Callable

from ..live.link.messages import Metres, TrackerMode, VehicleState
from ..live.tracker.vehicles import SimulatedVehicle
from .fault_plan import VehicleFault

OFFSET_M = 29.9
"""To the east."""
ORIGIN_M = 1000.0
"""To the east."""
FENCE_M = 30.0
"""From the origin, on each axis."""


class FailingVehicle:
    """A simulated vehicle as its agent or autopilot has it. Time passes for it at the site alone, whatever the agent's
    clock says.

    Args:
        fault: What is wrong with it now.
    """

    def __init__(self, vehicle: SimulatedVehicle, fault: Callable[[], VehicleFault | None]) -> None:
        self._vehicle, self._fault = vehicle, fault
        self.hold, self.said, self.health = vehicle.hold, vehicle.said, vehicle.health

    @property
    def position_m(self) -> Metres:
        """Where it says that it is."""
        x_m, y_m, z_m = self._vehicle.position_m
        fault = self._fault()
        off_m = OFFSET_M if fault is VehicleFault.OFFSET else ORIGIN_M if fault is VehicleFault.ORIGIN else 0.0
        return (x_m + off_m, y_m, z_m)

    @property
    def position_age_s(self) -> float:
        """None."""
        return self._vehicle.position_age_s

    @property
    def state(self) -> VehicleState:
        """Of a simulated vehicle."""
        return self._vehicle.state

    @property
    def velocity_mps(self) -> Metres:
        """How fast it is."""
        return self._vehicle.velocity_mps

    @property
    def mode(self) -> TrackerMode:
        """What it is doing."""
        return self._vehicle.mode

    def go_to(self, position_m: Metres) -> None:
        """Fly there, or do not."""
        fault = self._fault()
        x_m, y_m, z_m = position_m
        if fault is VehicleFault.STAYS:
            self._vehicle.hold()
        elif fault is VehicleFault.ORIGIN:
            self._vehicle.go_to((x_m - ORIGIN_M, y_m, z_m))
        elif fault is not VehicleFault.FENCE or max(abs(x_m), abs(y_m), abs(z_m)) <= FENCE_M:
            self._vehicle.go_to(position_m)

    def track(self, place_m: Metres, velocity_mps: Metres) -> None:
        """Be there now, as fast as that, or do not."""
        fault = self._fault()
        if fault is None or fault is VehicleFault.OFFSET:
            self._vehicle.track(place_m, velocity_mps)
        else:
            self.go_to(place_m)

    def update(self, now_ns: int) -> None:
        """The site does it."""

    def close(self) -> None:
        """Nothing is held."""
