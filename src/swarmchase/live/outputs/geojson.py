"""A recorded chase as GeoJSON (RFC 7946): longitude, latitude, and metres above the ellipsoid of WGS 84."""

import json
from collections.abc import Iterable
from typing import Any

from ..frame import Frame
from ..link.messages import Metres
from ..log.entries import LogHead
from .ellipse import ground_ellipse
from .kind import OutputDetails

OUTLINE_POINTS = 64
"""Of an ellipse."""
COLORS = {"swarm": "#000000", "estimate": "#7b3294", "target": "#d55e00"}
"""Of ways, by the names that maps take (simplestyle); of trackers: blue."""
TRACKER_COLOR = "#56b4e9"


def geojson(head: LogHead, frames: Iterable[Frame], details: OutputDetails) -> str:
    """The ways of trackers, swarm, estimate and simulated target, with the time of each point, and what was believed
    last.

    Args:
        details: with an origin.
    """
    ways: dict[str, _Way] = {}
    last: Frame | None = None
    for frame in frames:
        time_s = frame["time_s"]
        moment_ns = head.wall_ns(head.began_ns + round(time_s * 1e9))
        for name, place_m in _places_m(frame).items():
            way = ways.setdefault(name, _Way(name))
            if place_m is not None:
                way.add(moment_ns, _position(details, place_m))
        last = frame
    features = [way.feature() for way in ways.values() if way.positions]
    if last is not None and last["estimate"] is not None and last["estimate"]["region"] is not None:
        features.append(_region(last, details))
    return json.dumps({"type": "FeatureCollection", "features": features}, allow_nan=False) + "\n"


class _Way:
    """Of one thing, where it goes."""

    def __init__(self, name: str) -> None:
        self._name = name
        self.positions: list[list[float]] = []
        self._moments_ns: list[int] = []

    def add(self, moment_ns: int, position: list[float]) -> None:
        """It was there then; where it has stayed is not told again."""
        if not self.positions or position != self.positions[-1]:
            self.positions.append(position)
            self._moments_ns.append(moment_ns)

    def feature(self) -> dict[str, Any]:
        """A line, or a point where it never moved."""
        moves = len(self.positions) > 1
        properties = {
            "name": self._name,
            "stroke": COLORS.get(self._name, TRACKER_COLOR),
            "times": [round(moment_ns / 1e9, 3) for moment_ns in self._moments_ns],
        }
        geometry = {
            "type": "LineString" if moves else "Point",
            "coordinates": self.positions if moves else self.positions[0],
        }
        return {"type": "Feature", "properties": properties, "geometry": geometry}


def _places_m(frame: Frame) -> dict[str, list[float] | None]:
    places_m = {f"tracker {number}": tracker["position_m"] for number, tracker in enumerate(frame["trackers"])}
    estimate = frame["estimate"]
    return places_m | {
        "swarm": frame["center_m"],
        "estimate": None if estimate is None else estimate["position_m"],
        "target": frame["target_m"],
    }


def _region(frame: Frame, details: OutputDetails) -> dict[str, Any]:
    """The outline, from above, of what holds 95 % of the belief."""
    assert frame["estimate"] is not None
    region = frame["estimate"]["region"]
    assert region is not None
    east_m, north_m, up_m = region["center_m"]
    outline_m = ground_ellipse(region).outline_m(OUTLINE_POINTS)
    ring = [_position(details, [east_m + right_m, north_m + ahead_m, up_m]) for right_m, ahead_m in outline_m]
    properties = {"name": "target, 95 % of the belief at the end", "stroke": COLORS["estimate"], "fill-opacity": 0.2}
    geometry = {"type": "Polygon", "coordinates": [[*ring, ring[0]]]}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def _position(details: OutputDetails, place_m: list[float]) -> list[float]:
    metres: Metres = (place_m[0], place_m[1], place_m[2])
    position = details.on_ellipsoid(metres)
    assert position is not None, "whoever asks for GeoJSON has required an origin"
    latitude_deg, longitude_deg, height_m = position
    return [round(longitude_deg, 7), round(latitude_deg, 7), round(height_m, 2)]
