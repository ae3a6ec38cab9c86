"""A frame as Foxglove and Lichtblick draw it: a ``foxglove.SceneUpdate`` as its public JSON schema says."""

import math
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..estimate import EstimateFrame
from ..frame import Frame, TrackerFrame

SCENE_SCHEMA = "foxglove.SceneUpdate"
FRAME_ID = "site"
"""The shared frame, x east, y north, z up; nothing else is placed in the scene, so it needs no transform."""
LIFETIME_S = 2
"""What is not drawn again for so long is gone."""
TRACKER_M, CENTER_M, TARGET_M = 0.8, 0.5, 1.2
"""Diameters of spheres."""
TEXT_M = 1.5
"""Height of letters."""
LONGEST_WAY = 120
"""Of the swarm, in points: a minute in flight."""
LINE_STRIP = 0


class Time(TypedDict):
    """Since 1970; as a duration, how long."""

    sec: int
    nsec: int


class Vector(TypedDict):
    """Metres."""

    x: float
    y: float
    z: float


class Quaternion(TypedDict):
    """Of length 1."""

    x: float
    y: float
    z: float
    w: float


class Pose(TypedDict):
    """Where and how turned."""

    position: Vector
    orientation: Quaternion


class Color(TypedDict):
    """0 to 1."""

    r: float
    g: float
    b: float
    a: float


class Sphere(TypedDict):
    """An ellipsoid: its axes are ``size`` long, from end to end."""

    pose: Pose
    size: Vector
    color: Color


class Line(TypedDict):
    """Through all points, in one colour."""

    type: int
    pose: Pose
    thickness: float
    scale_invariant: bool
    points: list[Vector]
    color: Color
    colors: list[Color]
    indices: list[int]


class Text(TypedDict):
    """That faces whoever looks."""

    pose: Pose
    billboard: bool
    font_size: float
    scale_invariant: bool
    color: Color
    text: str


class KeyValuePair(TypedDict):
    """What a click shows."""

    key: str
    value: str


class Unused(TypedDict):
    """A form of Foxglove's that no chase has."""


class SceneEntity(TypedDict):
    """One thing that is drawn; it takes the place of the last of its ``id``."""

    timestamp: Time
    frame_id: str
    id: str
    lifetime: Time
    frame_locked: bool
    metadata: list[KeyValuePair]
    arrows: list[Unused]
    cubes: list[Unused]
    spheres: list[Sphere]
    cylinders: list[Unused]
    lines: list[Line]
    triangles: list[Unused]
    texts: list[Text]
    models: list[Unused]


class SceneUpdate(TypedDict):
    """All that is drawn at one moment."""

    deletions: list[Unused]
    entities: list[SceneEntity]


Point = NDArray[np.float64] | list[float]

UPRIGHT = Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
NOWHERE = Pose(position=Vector(x=0.0, y=0.0, z=0.0), orientation=UPRIGHT)
WHITE = Color(r=1.0, g=1.0, b=1.0, a=1.0)
GREY = Color(r=0.6, g=0.6, b=0.6, a=0.6)
BLUE = Color(r=0.34, g=0.71, b=0.91, a=1.0)
ORANGE = Color(r=0.9, g=0.62, b=0.0, a=1.0)
PURPLE = Color(r=0.48, g=0.2, b=0.58, a=1.0)
FAINT_PURPLE = Color(r=0.48, g=0.2, b=0.58, a=0.2)
RED = Color(r=0.84, g=0.37, b=0.0, a=1.0)
COLORS = {"there": BLUE, "silent": ORANGE, "manual": ORANGE, "left out": ORANGE}
"""Of trackers by their condition; of others: grey."""


def scene_of(frame: Frame, wall_ns: int) -> SceneUpdate:
    """Of this frame, so many nanoseconds since 1970: trackers, the swarm's way, the estimate with the ellipsoid that
    holds 95 % of the belief, and the target where it is known.
    """
    entities = [
        _tracker(number, tracker, tracker["position_m"], wall_ns)
        for number, tracker in enumerate(frame["trackers"])
        if tracker["position_m"] is not None
    ]
    if frame["center_m"] is not None:
        entities.append(_swarm(frame, frame["center_m"], wall_ns))
    if frame["estimate"] is not None:
        entities.append(_estimate(frame["estimate"], wall_ns))
    if frame["target_m"] is not None:
        spheres = [_sphere(frame["target_m"], TARGET_M, RED)]
        entities.append(_entity("target", wall_ns, spheres, texts=[_text(frame["target_m"], "target")]))
    return SceneUpdate(deletions=[], entities=entities)


def _tracker(number: int, tracker: TrackerFrame, position_m: list[float], wall_ns: int) -> SceneEntity:
    color = COLORS.get(tracker["condition"], GREY)
    set_point_m = tracker["set_point_m"]
    return _entity(
        f"tracker {number}",
        wall_ns,
        [_sphere(position_m, TRACKER_M, color)],
        [] if set_point_m is None else [_line([position_m, set_point_m], color)],
        [_text(position_m, f"{number}" if tracker["condition"] == "there" else f"{number} {tracker['condition']}")],
    )


def _swarm(frame: Frame, center_m: list[float], wall_ns: int) -> SceneEntity:
    way_m = frame["path_m"][-LONGEST_WAY:]
    lines = [_line(way_m, WHITE)] if len(way_m) > 1 else []
    return _entity(
        "swarm",
        wall_ns,
        [_sphere(center_m, CENTER_M, WHITE)],
        lines,
        [_text(center_m, frame["state"])],
        frame["reason"],
    )


def _estimate(estimate: EstimateFrame, wall_ns: int) -> SceneEntity:
    spheres = [_sphere(estimate["position_m"], TARGET_M, PURPLE)]
    if estimate["region"] is not None:
        spheres.append(_ellipsoid(estimate["region"]["center_m"], estimate["region"]["half_axes_m"]))
    return _entity("estimate", wall_ns, spheres, texts=[_text(estimate["position_m"], "estimate")])


def _entity(
    name: str,
    wall_ns: int,
    spheres: list[Sphere],
    lines: list[Line] | None = None,
    texts: list[Text] | None = None,
    reason: str = "",
) -> SceneEntity:
    return SceneEntity(
        timestamp=Time(sec=wall_ns // 1_000_000_000, nsec=wall_ns % 1_000_000_000),
        frame_id=FRAME_ID,
        id=name,
        lifetime=Time(sec=LIFETIME_S, nsec=0),
        frame_locked=True,
        metadata=[KeyValuePair(key="reason", value=reason)] if reason else [],
        arrows=[],
        cubes=[],
        spheres=spheres,
        cylinders=[],
        lines=lines or [],
        triangles=[],
        texts=texts or [],
        models=[],
    )


def _vector(point_m: Point) -> Vector:
    return Vector(x=float(point_m[0]), y=float(point_m[1]), z=float(point_m[2]))


def _sphere(position_m: Point, diameter_m: float, color: Color) -> Sphere:
    size = Vector(x=diameter_m, y=diameter_m, z=diameter_m)
    return Sphere(pose=Pose(position=_vector(position_m), orientation=UPRIGHT), size=size, color=color)


def _ellipsoid(center_m: Point, half_axes_m: list[list[float]]) -> Sphere:
    axes_m = np.array(half_axes_m, dtype=np.float64)
    lengths_m = np.linalg.norm(axes_m, axis=1)
    directions = axes_m / np.maximum(lengths_m, 1e-9)[:, None]
    # Rounded axes are not quite at right angles, and one of no length has no direction: the third follows from two.
    longest, middle, shortest = np.argsort(lengths_m)[::-1]
    first = directions[longest]
    second = directions[middle] - (directions[middle] @ first) * first
    if not (length := float(np.linalg.norm(second))) > 0.5 or not lengths_m[middle] > 0:
        return _sphere(center_m, 2 * float(lengths_m[longest]), FAINT_PURPLE)
    second = second / length
    turned = Rotation.from_matrix(np.column_stack([first, second, np.cross(first, second)]))
    x, y, z, w = (round(one, 4) for one in turned.as_quat().tolist())
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    return Sphere(
        pose=Pose(position=_vector(center_m), orientation=Quaternion(x=x / norm, y=y / norm, z=z / norm, w=w / norm)),
        size=_vector((2 * lengths_m[[longest, middle, shortest]]).round(2)),
        color=FAINT_PURPLE,
    )


def _line(points_m: list[list[float]], color: Color) -> Line:
    return Line(
        type=LINE_STRIP,
        pose=NOWHERE,
        thickness=2.0,
        scale_invariant=True,
        points=[_vector(point_m) for point_m in points_m],
        color=color,
        colors=[],
        indices=[],
    )


def _text(position_m: Point, text: str) -> Text:
    above = _vector(position_m)
    above["z"] = round(above["z"] + TRACKER_M, 3)
    return Text(
        pose=Pose(position=above, orientation=UPRIGHT),
        billboard=True,
        font_size=TEXT_M,
        scale_invariant=False,
        color=WHITE,
        text=text,
    )
