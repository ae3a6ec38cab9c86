"""Messages of older logs, made into those of this version: what they did not say is not known."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ..alarms import Severity, TrackerCondition
from ..estimate import estimate_of, region_of

_UNSAID = {"left_out": "", "notices": [], "dropped": {}}


def renewed_head(head: Any) -> Any:
    """A head of layout 1 to 4: it did not say where on the earth the chase was.

    Raises:
        KeyError, TypeError: it is no such head.
    """
    return head | {"global_origin": None} if head["layout"] < 5 else head


def renewal(layout: int) -> Callable[[Any], Any] | None:
    """What makes a frame of this layout one of this version; None where it is one."""
    return {1: _with_events, 2: _with_channel, 3: _with_flight}.get(layout)


def _with_flight(frame: Any) -> Any:
    """A frame of layout 3: it did not say how fast the target is, what was believed before, who is
    followed, and what autopilots tell.

    Raises:
        KeyError, TypeError, ValueError: it is no such frame.
    """
    points_m = frame["belief_m"] or []
    region = region_of(np.array(points_m, dtype=np.float64).reshape(-1, 3)) if len(points_m) > 1 else None
    estimate = frame["estimate"] and frame["estimate"] | {"velocity_mps": None, "region": region}
    return frame | {
        "estimate": estimate,
        "interception": None,
        "share_within": None,
        "following": None,
        "track": {"time_s": [], "target_m": [], "radius_m": [], "share_within": []},
        "trackers": [tracker | {"health": None} for tracker in frame["trackers"]],
    }


def _with_channel(frame: Any) -> Any:
    """A frame of layout 2: it did not say what the radio was found to be.

    Raises:
        KeyError, TypeError, ValueError: it is no such frame.
    """
    return _with_flight(frame | {"channel": None})


def _with_events(frame: Any) -> Any:
    """A frame of layout 1: its alarms were lines, and it had no events.

    Raises:
        AttributeError, KeyError, TypeError, ValueError: it is no such frame.
    """
    belief_m = frame["belief_m"] and np.array(frame["belief_m"], dtype=np.float64).reshape(-1, 3)
    center_m = frame["center_m"] and tuple(frame["center_m"])
    return _with_channel(
        frame
        | {
            "trackers": [tracker | {"condition": _condition(tracker)} | _UNSAID for tracker in frame["trackers"]],
            "alarms": [{"text": text, "severity": Severity.WARNING.value, "tracker": None} for text in frame["alarms"]],
            "events": [],
            "estimate": estimate_of(belief_m, center_m),
            "ended_s": None,
            "preflight": [],
        }
    )


def renewed_decision(decision: Any) -> Any:
    """A decision of layout 1 or 2: all trackers stopped to listen.

    Raises:
        TypeError: it is no such decision.
    """
    return decision | {"time_s": None}


def _condition(tracker: Any) -> str:
    if tracker["position_m"] is None:
        return TrackerCondition.EXPECTED.value
    if tracker["is_lost"]:
        return TrackerCondition.LOST.value
    if tracker["mode"] == "manual":
        return TrackerCondition.MANUAL.value
    return (TrackerCondition.SILENT if tracker["is_silent"] else TrackerCondition.THERE).value
