"""``swarmchase chase``: one chase, told movement by movement, or by the clock."""

import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.table import Table

from ..errors import InputError
from ..files import require_writable_file
from ..scenario import Scenario
from .options import DEFAULT_CONTROLLER, ActionChoice, ControllerName, ScenarioOptions, explain_choice
from .progress import progress_bar
from .terminal import CONSOLE, print_json, tell_replaced

TOLD_EVERY_S = 1.0
"""Of the chase's own time, where it is measured by the clock: at most one line."""


@dataclass(frozen=True, kw_only=True)
class ChaseCommand(ScenarioOptions):
    """Run one chase and tell it movement by movement, or second by second; leave a log and a picture of it."""

    controller: ControllerName = DEFAULT_CONTROLLER
    action_choice: ActionChoice | None = None
    """How a learned controller acts: sampled from its policies or greedy; default is what its weights file says."""
    seed: int = 0
    """Seed of the run the chase belongs to."""
    chase: int = 0
    """Number of the chase in its run."""
    folder: Path = Path("chase-output")
    """Folder for chase.json (the log) and chase.png (the picture); those of the chase before are replaced."""
    animation: Path | None = None
    """Also make a film of it, for instance chase.gif, or chase.mp4 where there is ffmpeg."""
    overwrite: bool = False
    """Replace the film if it is there already."""
    json: bool = False
    """Print the log's summary as one JSON object on standard output."""

    def run(self) -> None:
        """Chase, tell, report, log, draw and film."""
        from ..controllers import load_controller
        from ..evaluation.chase_log import Moment, chase_log, run_chase, save_chase_log
        from ..reports.animation import require_animation_format
        from ..reports.chase import draw_chase
        from ..world.environment import require_world

        if self.seed < 0 or self.chase < 0:
            raise InputError(f"seed = {self.seed}, chase = {self.chase} is refused: both must be at least 0")
        log_path, picture_path = self.folder / "chase.json", self.folder / "chase.png"
        require_writable_file(log_path, replaces=True)
        require_writable_file(picture_path, replaces=True)
        if self.animation is not None:
            require_animation_format(self.animation)
            require_writable_file(self.animation, replaces=self.overwrite)
        scenario = self.world()
        controller = load_controller(self.controller, scenario, self.action_choice)
        require_world(scenario)
        explain_choice(self.controller, scenario)
        CONSOLE.print(f"{_opening(scenario)}\n", markup=False)
        CONSOLE.print(_TIMED_HEAD if scenario.is_told_in_seconds else _HEAD, markup=False, soft_wrap=True)
        moments: list[Moment] = []
        told: dict[str, Any] | None = None
        for moment in run_chase(scenario, controller, self.seed, self.chase):
            moments.append(moment)
            now = asdict(moment)
            if not scenario.is_told_in_seconds:
                CONSOLE.print(_line(now), soft_wrap=True)
            elif _is_told(now, told):
                CONSOLE.print(_timed_line(now, told), soft_wrap=True)
                told = now
        log = chase_log(scenario, controller, self.seed, self.chase, moments)
        CONSOLE.print()
        CONSOLE.print(_summary(log))
        try:
            if self.json:
                print_json({name: value for name, value in log.items() if name != "moments"})
        finally:
            tell_replaced([log_path, picture_path])
            save_chase_log(log_path, log)
            draw_chase(log, picture_path)
            CONSOLE.print(f"Log: {log_path}   Picture: {picture_path}", markup=False, soft_wrap=True)
            if self.animation is not None:
                _film(log, self.animation)


def _opening(scenario: Scenario) -> str:
    """What flies, from where, and when the trackers listen."""
    nearest_m, farthest_m = scenario.start_distance_m, scenario.farthest_start_m
    where = f"{nearest_m:g} m" if farthest_m is None else f"{nearest_m:g} to {farthest_m:g} m"
    target = f"The target is {where} away in an unknown direction"
    if scenario.behaviour != "hover":
        target += f" and flies ({Path(scenario.behaviour).name}) at up to {scenario.target_speed_mps:g} m/s"
    if scenario.pace == "stop_and_listen":
        heard = f"{scenario.window_samples} samples at {scenario.sampling_hz:g} Hz before each movement"
        return f"{target}. Six trackers listen: {heard}."
    return (
        f"{target}. Six trackers fly at up to {scenario.tracker_speed_mps:g} m/s and listen on their way: "
        f"{scenario.sampling_hz:g} samples a second, a decision every {scenario.decision_s:g} s."
    )


def _line(moment: dict[str, Any]) -> str:
    """A movement as the log holds it; at most 80 columns, as ``_HEAD`` names them."""
    displacement = "(" + ", ".join(f"{metres:+.0f}" for metres in moment["displacement_m"]) + ")"
    return (
        f"{moment['movement']:3d}  {displacement if moment['movement'] > 0 else 'start':>12}  "
        f"{_center(moment)}  {moment['spacing_m']:4.1f} m  {_strongest_dbm(moment):6.1f} dBm  "
        f"{moment['distance_m']:5.1f} m away" + ("  reached" if moment["reached"] else "")
    )


def _timed_line(moment: dict[str, Any], before: dict[str, Any] | None) -> str:
    """A moment as the log holds it, as ``_TIMED_HEAD`` names it; ``before`` is the one that was told before it."""
    if before is None:
        closing = "start"
    else:
        closed_m, seconds = before["distance_m"] - moment["distance_m"], moment["time_s"] - before["time_s"]
        closing = f"{closed_m / seconds:+.1f} m/s"
    # It may have been reached before this moment, and be farther away by now.
    ending = "  reached" if _is_capture(moment, before) else ""
    return (
        f"{moment['time_s']:6.1f} s  {moment['distance_m']:5.1f} m away  {closing:>9}  {_center(moment)}  "
        f"{moment['spacing_m']:4.1f} m  {_strongest_dbm(moment):6.1f} dBm{ending}"
    )


_HEAD = f"{'':3}  {'moves (m)':>12}  {'centre (m)':^18}  spacing  {'loudest':>8}  target"
_TIMED_HEAD = f"{'time':>6}    {'target':>7}       {'closing':>9}  {'centre (m)':^18}  spacing  loudest"


def _is_told(moment: dict[str, Any], before: dict[str, Any] | None) -> bool:
    """The first, the last, and between them at most one every ``TOLD_EVERY_S``."""
    if before is None or moment["reached"] or moment["truncated"] or _is_capture(moment, before):
        return True
    return bool(moment["time_s"] - before["time_s"] >= TOLD_EVERY_S - 1e-9)


def _is_capture(moment: dict[str, Any], before: dict[str, Any] | None) -> bool:
    """Whether the target was first reached since the moment that was told before."""
    return moment["reached_s"] is not None and (before is None or before["reached_s"] is None)


def _center(moment: dict[str, Any]) -> str:
    return "(" + ", ".join(f"{coordinate:+4.0f}" for coordinate in moment["center_m"]) + ")"


def _strongest_dbm(moment: dict[str, Any]) -> float:
    """The highest of the six trackers' means."""
    return float(max(sum(trace) / len(trace) for trace in zip(*moment["rssi_dbm"], strict=True)))


def _summary(log: dict[str, Any]) -> Table:
    table = Table(show_header=False)
    table.add_row("Ending", "target reached" if log["reached"] else "target not reached")
    if "capture_s" in log:
        table.add_row("Capture time" if log["reached"] else "Time", f"{log['capture_s']:.1f} s")
        table.add_row("Least distance", f"{log['least_distance_m']:.2f} m")
        table.add_row("Way of the centre", f"{log['path_length_m']:.0f} m")
        return table
    table.add_row("Movements", f"{log['movements']}")
    table.add_row("Final distance", f"{log['final_distance_m']:.2f} m")
    table.add_row("Path flown", f"{log['path_length_m']:.0f} m")
    for speed, seconds in log["tracking_time_s"].items():
        table.add_row(f"Tracking time at {speed} m/s", f"{seconds:.0f} s")
    return table


def _film(log: dict[str, Any], path: Path) -> None:
    """With a bar."""
    from ..reports.animation import draw_animation, num_frames

    total, began_s = num_frames(log), time.monotonic()
    with progress_bar("film", total, "frames/s") as show:
        draw_animation(log, path, lambda frames: show(frames, f"{frames / (time.monotonic() - began_s):.1f}", ""))
    CONSOLE.print(f"Film: {path}", markup=False, soft_wrap=True)
