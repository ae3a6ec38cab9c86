"""A recorded chase as CSV, a row a frame. What is not known is empty."""

import csv
import io
from collections.abc import Iterable
from datetime import UTC, datetime

from ..frame import Frame
from ..log.entries import LogHead
from .kind import OutputDetails

Cell = str | float | None


def csv_table(head: LogHead, frames: Iterable[Frame], details: OutputDetails) -> str:
    """With its head. Latitude, longitude and height above the ellipsoid are there where the origin is known."""
    text = io.StringIO()
    writer: csv.DictWriter[str] | None = None
    for frame in frames:
        row = _row(head, frame, details)
        if writer is None:
            writer = csv.DictWriter(text, list(row), lineterminator="\n")
            writer.writeheader()
        writer.writerow(row)
    return text.getvalue()


def _row(head: LogHead, frame: Frame, details: OutputDetails) -> dict[str, Cell]:
    wall_ns = head.wall_ns(head.began_ns + round(frame["time_s"] * 1e9))
    moment = datetime.fromtimestamp(wall_ns // 1_000_000_000, UTC)
    estimate = frame["estimate"]
    row: dict[str, Cell] = {
        "time_utc": f"{moment:%Y-%m-%dT%H:%M:%S}.{wall_ns // 1_000_000 % 1000:03d}Z",
        "time_s": frame["time_s"],
        "state": frame["state"],
        "movements": frame["movements"],
        "spacing_m": frame["spacing_m"],
        **_place("swarm", frame["center_m"], details),
        **_place("estimate", None if estimate is None else estimate["position_m"], details),
        "estimate_radius_m": None if estimate is None else estimate["radius_m"],
        "estimate_distance_m": None if estimate is None else estimate["distance_m"],
        **_place("target", frame["target_m"], details),
    }
    for number, tracker in enumerate(frame["trackers"]):
        heard_dbm = [level_dbm for level_dbm in tracker["rssi_dbm"] if level_dbm is not None]
        row |= {
            **_place(f"tracker_{number}", tracker["position_m"], details),
            f"tracker_{number}_condition": tracker["condition"],
            f"tracker_{number}_rssi_dbm": heard_dbm[-1] if heard_dbm else None,
        }
    return row


def _place(name: str, place_m: list[float] | None, details: OutputDetails) -> dict[str, Cell]:
    east_m, north_m, up_m = (None, None, None) if place_m is None else place_m
    cells: dict[str, Cell] = {f"{name}_x_m": east_m, f"{name}_y_m": north_m, f"{name}_z_m": up_m}
    if details.origin is None:
        return cells
    position = None if place_m is None else details.on_ellipsoid((place_m[0], place_m[1], place_m[2]))
    latitude_deg, longitude_deg, height_m = (None, None, None) if position is None else position
    return cells | {
        f"{name}_latitude_deg": None if latitude_deg is None else round(latitude_deg, 7),
        f"{name}_longitude_deg": None if longitude_deg is None else round(longitude_deg, 7),
        f"{name}_altitude_geodetic_m": None if height_m is None else round(height_m, 2),
    }
