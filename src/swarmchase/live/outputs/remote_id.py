"""The estimate as one flat JSON object, in the terms of Remote ID (ASTM F3411's Location message, as MAVLink's
OPEN_DRONE_ID_LOCATION names them), with the unit in each name.
"""

import json
import math
from datetime import UTC, datetime
from typing import TypedDict

from ..frame import Frame
from .ellipse import ground_ellipse
from .kind import OutputDetails


class EstimateMessage(TypedDict):
    """What is not known is null."""

    time: str
    """ISO 8601, UTC."""
    uas_id: str
    """Of the target as this swarm knows it: nobody has told its own."""
    is_simulated: bool
    state: str
    """Of the chase."""
    latitude_deg: float | None
    longitude_deg: float | None
    altitude_geodetic_m: float | None
    """Above the ellipsoid of WGS 84."""
    horizontal_accuracy_m: float | None
    """95 % of the belief is within this, seen from above: the longer half axis of its region."""
    vertical_accuracy_m: float | None
    """The same in height."""
    direction_deg: float | None
    """In which it flies, clockwise from north."""
    speed_horizontal_mps: float | None
    speed_vertical_mps: float | None
    position_m: list[float] | None
    """In the shared frame, x east, y north, z up."""
    distance_m: float | None
    """From the swarm's centre."""
    bearing_deg: float | None
    """From there, clockwise from north."""


def estimate_message(frame: Frame, wall_ns: int, details: OutputDetails) -> bytes:
    """Of this frame, so many nanoseconds since 1970; without a line feed."""
    estimate = frame["estimate"]
    position_m = None if estimate is None else estimate["position_m"]
    velocity_mps = None if estimate is None else estimate["velocity_mps"]
    region = None if estimate is None else estimate["region"]
    ellipse = None if region is None else ground_ellipse(region)
    position = None if position_m is None else details.on_ellipsoid((position_m[0], position_m[1], position_m[2]))
    moment = datetime.fromtimestamp(wall_ns // 1_000_000_000, UTC)
    message = EstimateMessage(
        time=f"{moment:%Y-%m-%dT%H:%M:%S}.{wall_ns // 1_000_000 % 1000:03d}Z",
        uas_id=f"swarmchase-{details.station}-estimate",
        is_simulated=details.is_simulated,
        state=frame["state"],
        latitude_deg=None if position is None else round(position[0], 7),
        longitude_deg=None if position is None else round(position[1], 7),
        altitude_geodetic_m=None if position is None else round(position[2], 1),
        horizontal_accuracy_m=None if ellipse is None else round(ellipse.semi_major_m, 1),
        vertical_accuracy_m=None if ellipse is None else round(ellipse.half_height_m, 1),
        direction_deg=None
        if velocity_mps is None
        else round(math.degrees(math.atan2(velocity_mps[0], velocity_mps[1])) % 360, 1),
        speed_horizontal_mps=None if velocity_mps is None else round(math.hypot(*velocity_mps[:2]), 2),
        speed_vertical_mps=None if velocity_mps is None else velocity_mps[2],
        position_m=position_m,
        distance_m=None if estimate is None else estimate["distance_m"],
        bearing_deg=None if estimate is None else estimate["bearing_deg"],
    )
    return json.dumps(message, allow_nan=False).encode()
