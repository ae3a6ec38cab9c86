"""The picture of a live chase from its log: both ways from above, and over time what it was doing and how far it was.

Frames are read once, one by one, so that a log of hours can be drawn.
"""

import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.transforms import blended_transform_factory
from numpy.typing import NDArray

from .plan_view import CENTER_STYLE, TARGET_STYLE, PathStyle, draw_end, draw_path, draw_start, set_view
from .style import PAGE_WIDTH_INCHES, STYLE, TARGET_COLOR

PLAN_HEIGHT_SHARE = 1.25
"""Of the plan's width."""
BELIEF_STYLE = PathStyle("target, as believed", "#7B3294", ":", "s")
STATE_COLORS = {
    "idle": "#D9D9D9",
    "connecting": "#CC79A7",
    "under way": "#56B4E9",
    "pursuing": "#56B4E9",
    "holding": "#E69F00",
    "reached": "#009E73",
    "following": "#009E73",
    "lost": "#D55E00",
    "aborted": "#D55E00",
}
OTHER_STATE_COLOR = "#999999"
LEAST_NAMED_SHARE = 0.09
"""Of the chase's length: a state that lasts less has no room for its name."""
LEAST_APART_SHARE = 0.03
"""Of the chase's length: between two numbers of events."""
STOPPING = {"sampling": "under way", "moving": "under way"}
"""They alternate, movement by movement."""
MOST_EVENTS = 12
"""That are numbered and told; the gravest, then the first."""
RANKS = {"critical": 0, "success": 1, "warning": 2}
"""What is not here is not told."""
LONGEST_TEXT = 96


@dataclass(frozen=True)
class RecordedEvent:
    """Something that has happened."""

    time_s: float
    severity: str
    text: str


@dataclass(frozen=True)
class _Columns:
    """Of the frames that have a centre, [moment] and [moment, 3]; NaN where something is not known."""

    time_s: NDArray[np.float64]
    state: list[str]
    center_m: NDArray[np.float64]
    target_m: NDArray[np.float64]
    believed_m: NDArray[np.float64]
    radius_m: NDArray[np.float64]
    share_within: NDArray[np.float64]


def recorded_chase_picture(
    frames: Iterable[Any], events: Sequence[RecordedEvent], title: str, success_radius_m: float
) -> bytes:
    """As PNG, from the frames of a log (``live.frame``).

    Raises:
        ValueError: in no frame the trackers have a centre.
    """
    columns = _columns(frames)
    told = told_events(events)
    with mpl.rc_context(STYLE):
        lines = max(len(told), 1)
        height_inches = 4.6 + 0.14 * lines
        figure = Figure(figsize=(PAGE_WIDTH_INCHES, height_inches), layout="constrained")
        grid = figure.add_gridspec(5, 2, width_ratios=(1, 1.15), height_ratios=(0.16, 1, 1, 0.8, 0.14 * lines))
        plan_axes = figure.add_subplot(grid[:4, 0])
        rows = [figure.add_subplot(grid[row, 1]) for row in range(4)]
        for axes in rows[:3]:
            axes.sharex(rows[3])
            axes.tick_params(labelbottom=False)
        _draw_plan(plan_axes, columns)
        unnamed = _draw_states(rows[0], columns)
        _draw_distance(rows[1], columns, success_radius_m)
        _draw_belief(rows[2], columns, success_radius_m)
        _draw_height(rows[3], columns)
        rows[3].set(xlabel="time (s)", xlim=(columns.time_s[0], max(columns.time_s[-1], columns.time_s[0] + 1)))
        _mark_events(rows[0], rows[1:], told)
        _tell_events(figure.add_subplot(grid[4, :]), told, len(events))
        figure.align_ylabels(rows[1:])
        if unnamed:
            handles = [Patch(facecolor=color, label=name) for name, color in unnamed.items()]
            figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
        figure.suptitle(title, fontsize=8)
        picture = io.BytesIO()
        figure.savefig(picture, format="png", dpi=200, metadata={"Title": title})
        return picture.getvalue()


def _columns(frames: Iterable[Any]) -> _Columns:
    nowhere = [np.nan] * 3
    time_s, state, center_m, target_m, believed_m, radius_m, share = [], [], [], [], [], [], []
    for frame in frames:
        if frame["center_m"] is None:
            continue
        estimate = frame["estimate"]
        time_s.append(frame["time_s"])
        state.append(STOPPING.get(frame["state"], frame["state"]))
        center_m.append(_center_m(frame))
        target_m.append(frame["target_m"] or nowhere)
        believed_m.append(nowhere if estimate is None else estimate["position_m"])
        radius_m.append(np.nan if estimate is None or estimate["radius_m"] is None else estimate["radius_m"])
        share.append(np.nan if frame["share_within"] is None else frame["share_within"])
    if not time_s:
        raise ValueError("no frame has a centre")
    return _Columns(
        time_s=np.array(time_s, dtype=np.float64),
        state=state,
        center_m=np.array(center_m, dtype=np.float64),
        target_m=np.array(target_m, dtype=np.float64),
        believed_m=np.array(believed_m, dtype=np.float64),
        radius_m=np.array(radius_m, dtype=np.float64),
        share_within=np.array(share, dtype=np.float64),
    )


def _center_m(frame: Any) -> list[float]:
    """Where the six are; where one is missing, where the formation was told to be."""
    positions_m = [tracker["position_m"] for tracker in frame["trackers"]]
    center_m: list[float] = frame["center_m"] if None in positions_m else np.mean(positions_m, axis=0).tolist()
    return center_m


def told_events(events: Sequence[RecordedEvent]) -> list[RecordedEvent]:
    """The gravest, in the order of their time."""
    grave = [event for event in events if event.severity in RANKS]
    grave.sort(key=lambda event: (RANKS[event.severity], event.time_s))
    return sorted(grave[:MOST_EVENTS], key=lambda event: event.time_s)


def _draw_plan(axes: Axes, columns: _Columns) -> None:
    ways = [
        (style, place_m[np.isfinite(place_m).all(axis=1), :2])
        for style, place_m in (
            (BELIEF_STYLE, columns.believed_m),
            (TARGET_STYLE, columns.target_m),
            (CENTER_STYLE, columns.center_m),
        )
    ]
    ways = [(style, place_m) for style, place_m in ways if len(place_m)]
    # A belief may wander far at first: the view is of what is known.
    known_m = np.concatenate([place_m for style, place_m in ways if style is not BELIEF_STYLE])
    set_view(axes, known_m, PLAN_HEIGHT_SHARE)
    for style, place_m in ways:
        draw_path(axes, style, place_m)
    for style, place_m in ways:
        if style is not BELIEF_STYLE:
            draw_start(axes, style, place_m)
        draw_end(axes, style, place_m)
    axes.legend(
        handles=[style.handle() for style, _ in reversed(ways)],
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
        ncols=3,
        frameon=False,
        title="hollow: start, filled: end",
        title_fontsize=7,
        columnspacing=1.0,
        handlelength=1.6,
    )


def _draw_states(axes: Axes, columns: _Columns) -> dict[str, str]:
    """A strip; returns the colours of the states that nowhere last long enough for their name."""
    begins = [0, *(index for index in range(1, len(columns.state)) if columns.state[index] != columns.state[index - 1])]
    ends_s = [*columns.time_s[begins[1:]], columns.time_s[-1]]
    length_s = max(columns.time_s[-1] - columns.time_s[0], 1e-9)
    colors = {name: STATE_COLORS.get(name, OTHER_STATE_COLOR) for name in columns.state}
    named = set()
    for begin, end_s in zip(begins, ends_s, strict=True):
        name, begin_s = columns.state[begin], columns.time_s[begin]
        axes.axvspan(begin_s, end_s, color=colors[name], lw=0)
        if end_s - begin_s >= LEAST_NAMED_SHARE * length_s:
            named.add(name)
            axes.text((begin_s + end_s) / 2, 0.45, name, ha="center", va="center", fontsize=7)
    axes.set(ylim=(0, 1), yticks=[])
    axes.grid(visible=False)
    axes.tick_params(bottom=False)
    return {name: color for name, color in colors.items() if name not in named}


def _draw_distance(axes: Axes, columns: _Columns, success_radius_m: float) -> None:
    for style, place_m in ((BELIEF_STYLE, columns.believed_m), (TARGET_STYLE, columns.target_m)):
        distance_m = np.linalg.norm(columns.center_m - place_m, axis=1)
        if np.isfinite(distance_m).any():
            label = "to where it is believed" if style is BELIEF_STYLE else "to the simulated target"
            axes.plot(columns.time_s, distance_m, color=style.color, ls=style.line, lw=1, label=label)
    axes.axhline(success_radius_m, color=TARGET_COLOR, ls=":", lw=0.8)
    axes.set(ylabel="distance (m)")
    axes.set_ylim(bottom=0)
    _legend(axes)


def _draw_belief(axes: Axes, columns: _Columns, success_radius_m: float) -> None:
    axes.set_ylabel("radius (m)")
    if np.isfinite(columns.radius_m).any():
        axes.plot(columns.time_s, columns.radius_m, color=BELIEF_STYLE.color, lw=1, label="95 % of the belief")
        axes.set_yscale("log")
        _legend(axes)
    if np.isfinite(columns.share_within).any():
        other = axes.twinx()
        other.plot(columns.time_s, 100 * columns.share_within, color="black", ls="--", lw=0.8)
        other.set(ylabel=f"within {success_radius_m:g} m (%, dashed)", ylim=(0, 100))
        other.grid(visible=False)
        other.spines["right"].set_visible(True)


def _draw_height(axes: Axes, columns: _Columns) -> None:
    for style, place_m in ((CENTER_STYLE, columns.center_m), (TARGET_STYLE, columns.target_m)):
        draw_path(axes, style, np.column_stack([columns.time_s, place_m[:, 2]]))
    axes.set_ylabel("height (m)")


def _legend(axes: Axes) -> None:
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.97), frameon=False, ncols=2, borderaxespad=0.0)


def _mark_events(strip: Axes, rows: Sequence[Axes], told: Sequence[RecordedEvent]) -> None:
    """A line through all rows, and the event's number above the strip."""
    above = blended_transform_factory(strip.transData, strip.transAxes)
    low_s, high_s = strip.get_xlim()
    named_s = -np.inf
    for number, event in enumerate(told, start=1):
        for axes in (strip, *rows):
            axes.axvline(event.time_s, color="black", lw=0.5, ls=(0, (2, 3)))
        # Of those that come close upon one another the first is named.
        if event.time_s - named_s >= LEAST_APART_SHARE * (high_s - low_s):
            named_s = event.time_s
            strip.text(event.time_s, 1.1, str(number), transform=above, ha="center", fontsize=6)


def _tell_events(axes: Axes, told: Sequence[RecordedEvent], num_events: int) -> None:
    axes.axis("off")
    lines = [f"{number}  {event.time_s:.1f} s  {_short(event.text)}" for number, event in enumerate(told, start=1)]
    lines = lines or [f"none of {num_events} events matters"]
    axes.text(0, 1, "\n".join(lines), transform=axes.transAxes, va="top", fontsize=6.5, linespacing=1.35)


def _short(text: str) -> str:
    return text if len(text) <= LONGEST_TEXT else f"{text[: LONGEST_TEXT - 3]}..."
