"""A frame as Cursor-on-Target events, version 2.0 (MITRE's Event.xsd of 2003), as ATAK and WinTAK draw them."""

import math
import re
from datetime import UTC, datetime, timedelta
from xml.etree import ElementTree

from ..estimate import EstimateFrame
from ..frame import Frame, TrackerFrame
from ..link.messages import Metres
from .ellipse import GroundEllipse, ground_ellipse
from .kind import OutputDetails

STALE_S = 10.0
"""What is not told again for so long is greyed on the map."""
UNKNOWN_M = 9_999_999.0
"""TAK's word for an error that nobody knows."""
TRACKER_TYPE = "a-f-A-M-F-Q"
"""A friendly unmanned aircraft."""
ESTIMATE_TYPE = "a-u-A"
"""An unknown aircraft: to call it hostile is for a person."""
REGION_TYPE = "u-d-c-c"
"""A drawn circle or ellipse."""
BY_GPS, FUSED, SIMULATED = "m-g", "m-f", "m-s"
"""How a place was found out: from a GPS receiver, from several sources, in a simulation."""
SIMULATION = "s-swarmchase"
"""Of ``opex``: the event is of a simulation."""
STROKE_COLOR, FILL_COLOR = -1_663_232, 870_752_000
"""Of the region: the orange E69F00, opaque and with a fifth of that, as signed 32-bit ARGB."""
NOT_OF_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def cot_events(frame: Frame, wall_ns: int, details: OutputDetails) -> list[bytes]:
    """One XML document each: the swarm's centre with the state of the chase, each tracker whose place is known, and the
    estimate with its region.

    Args:
        wall_ns: when the frame was taken, since 1970.
        details: with an origin.
    """
    writer = _Writer(wall_ns, details)
    events = [writer.swarm(frame, frame["center_m"])] if frame["center_m"] is not None else []
    for number, tracker in enumerate(frame["trackers"]):
        if tracker["position_m"] is not None and not tracker["is_lost"]:
            events.append(writer.tracker(number, tracker, tracker["position_m"]))
    if frame["estimate"] is not None:
        events += writer.estimate(frame["estimate"])
    return events


class _Writer:
    """Of the events of one moment."""

    def __init__(self, wall_ns: int, details: OutputDetails) -> None:
        self._details = details
        self._moment = datetime.fromtimestamp(wall_ns // 1_000_000_000, UTC).replace(
            microsecond=wall_ns // 1000 % 1_000_000
        )

    def swarm(self, frame: Frame, center_m: list[float]) -> bytes:
        """The formation's centre, which says what the chase is doing."""
        event, detail = self._event("swarm", TRACKER_TYPE, BY_GPS, center_m, None)
        _add(detail, "contact", callsign=f"swarm: {frame['state']}")
        said = f"{frame['state']}: {frame['reason']}" if frame["reason"] else frame["state"]
        _add(detail, "remarks").text = _plain(f"{said}; {frame['movements']} movements")
        return _document(event)

    def tracker(self, number: int, tracker: TrackerFrame, position_m: list[float]) -> bytes:
        """One of the six."""
        event, detail = self._event(f"tracker-{number}", TRACKER_TYPE, BY_GPS, position_m, None)
        _add(detail, "contact", callsign=f"tracker {number}")
        _add(detail, "precisionlocation", geopointsrc="GPS", altsrc="GPS")
        _add(detail, "link", uid=self._uid("swarm"), type=TRACKER_TYPE, relation="p-p")
        health = tracker["health"]
        if health is not None and health["battery_percent"] is not None:
            _add(detail, "status", battery=str(health["battery_percent"]))
        words = [tracker["condition"], tracker["left_out"], tracker["mode"] or ""]
        _add(detail, "remarks").text = _plain("; ".join(word for word in words if word))
        return _document(event)

    def estimate(self, estimate: EstimateFrame) -> list[bytes]:
        """Where the target is taken to be, and, of a belief that has more than a point, where it is with 95 %."""
        region = estimate["region"]
        ellipse = None if region is None else ground_ellipse(region)
        event, detail = self._event("estimate", ESTIMATE_TYPE, FUSED, estimate["position_m"], ellipse)
        _add(detail, "contact", callsign="target, estimated")
        _add(detail, "link", uid=self._uid("swarm"), type=TRACKER_TYPE, relation="p-p")
        if estimate["velocity_mps"] is not None:
            east_mps, north_mps, _ = estimate["velocity_mps"]
            course_deg = math.degrees(math.atan2(east_mps, north_mps)) % 360
            _add(detail, "track", course=f"{course_deg:.1f}", speed=f"{math.hypot(east_mps, north_mps):.2f}")
        radius = "" if estimate["radius_m"] is None else f"; 95 % within {estimate['radius_m']:.1f} m"
        _add(
            detail, "remarks"
        ).text = f"{estimate['distance_m']:.1f} m from the swarm, bearing {estimate['bearing_deg']:.0f} degrees{radius}"
        if region is None or ellipse is None:
            return [_document(event)]
        return [_document(event), self._region(region["center_m"], ellipse)]

    def _region(self, center_m: list[float], ellipse: GroundEllipse) -> bytes:
        event, detail = self._event("region", REGION_TYPE, FUSED, center_m, ellipse)
        _add(detail, "contact", callsign="target, 95 %")
        shape = _add(detail, "shape")
        _add(
            shape,
            "ellipse",
            major=f"{ellipse.semi_major_m:.2f}",
            minor=f"{ellipse.semi_minor_m:.2f}",
            angle=f"{ellipse.azimuth_deg:.1f}",
        )
        _add(detail, "strokeColor", value=str(STROKE_COLOR))
        _add(detail, "strokeWeight", value="3.0")
        _add(detail, "fillColor", value=str(FILL_COLOR))
        _add(detail, "labels_on", value="false")
        _add(detail, "link", uid=self._uid("estimate"), type=ESTIMATE_TYPE, relation="p-p")
        return _document(event)

    def _event(
        self, name: str, kind: str, how: str, position_m: list[float], ellipse: GroundEllipse | None
    ) -> tuple[ElementTree.Element, ElementTree.Element]:
        """An event and its detail."""
        event = ElementTree.Element("event", version="2.0", uid=self._uid(name), type=kind)
        if self._details.is_simulated:
            event.set("opex", SIMULATION)
        event.set("time", _time(self._moment))
        event.set("start", _time(self._moment))
        event.set("stale", _time(self._moment + timedelta(seconds=STALE_S)))
        event.set("how", SIMULATED if self._details.is_simulated else how)
        east_m, north_m, up_m = position_m
        latitude_deg, longitude_deg, height_m = self._on_ellipsoid((east_m, north_m, up_m))
        _add(
            event,
            "point",
            lat=f"{latitude_deg:.7f}",
            lon=f"{longitude_deg:.7f}",
            hae=f"{height_m:.2f}",
            ce=f"{UNKNOWN_M if ellipse is None else ellipse.circular_error_m:.2f}",
            le=f"{UNKNOWN_M if ellipse is None else ellipse.linear_error_m:.2f}",
        )
        return event, _add(event, "detail")

    def _on_ellipsoid(self, position_m: Metres) -> Metres:
        position = self._details.on_ellipsoid(position_m)
        assert position is not None, "an output of such events has required an origin"
        return position

    def _uid(self, name: str) -> str:
        return f"swarmchase-{self._details.station}-{name}"


def _add(parent: ElementTree.Element, name: str, **attributes: str) -> ElementTree.Element:
    return ElementTree.SubElement(parent, name, attributes)


def _document(event: ElementTree.Element) -> bytes:
    document: bytes = ElementTree.tostring(event, encoding="UTF-8", xml_declaration=True)
    return document


def _time(moment: datetime) -> str:
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{moment.microsecond // 1000:03d}Z"


def _plain(text: str) -> str:
    """Without characters that no XML may hold."""
    return NOT_OF_XML.sub("?", text)
