"""``swarmchase chase``: one chase, told movement by movement."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.table import Table

from ..errors import InputError
from ..files import require_writable_file
from .options import ActionChoice, ControllerName, ScenarioOptions
from .terminal import CONSOLE, explain_choice, print_json


@dataclass(frozen=True, kw_only=True)
class ChaseCommand(ScenarioOptions):
    """Run one chase and tell it movement by movement; leave a log and a picture of it."""

    controller: ControllerName = "paper"
    action_choice: ActionChoice | None = None
    """How a learned controller acts: sampled from its policies or greedy; default is what its weights file says."""
    seed: int = 0
    """Seed of the run the chase belongs to."""
    chase: int = 0
    """Number of the chase in its run."""
    folder: Path = Path("chase-output")
    """Folder for chase.json (the log) and chase.png (the picture)."""
    json: bool = False
    """Print the log's summary as one JSON object on standard output."""

    def run(self) -> None:
        """Chase, tell, report, log and draw."""
        from ..controllers import load_controller
        from ..evaluation.chase_log import Moment, chase_log, run_chase, save_chase_log
        from ..reports.chase import draw_chase

        if self.seed < 0 or self.chase < 0:
            raise InputError(f"seed = {self.seed}, chase = {self.chase} is refused: both must be at least 0")
        log_path, picture_path = self.folder / "chase.json", self.folder / "chase.png"
        require_writable_file(log_path)
        require_writable_file(picture_path)
        scenario = self.scenario()
        controller = load_controller(self.controller, scenario, self.action_choice)
        explain_choice(self.controller, scenario)
        CONSOLE.print(
            f"The target is {scenario.start_distance_m:g} m away in an unknown direction. Six trackers listen: "
            f"{scenario.window_samples} samples at {scenario.sampling_hz:g} Hz before each movement.\n",
            soft_wrap=True,
        )
        moments: list[Moment] = []
        for moment in run_chase(scenario, controller, self.seed, self.chase):
            moments.append(moment)
            CONSOLE.print(_line(asdict(moment)), soft_wrap=True)
        log = chase_log(scenario, controller, self.seed, self.chase, moments)
        CONSOLE.print()
        CONSOLE.print(_summary(log))
        try:
            if self.json:
                print_json({name: value for name, value in log.items() if name != "moments"})
        finally:
            save_chase_log(log_path, log)
            draw_chase(log, picture_path)
            CONSOLE.print(f"Log: {log_path}   Picture: {picture_path}", markup=False, soft_wrap=True)


def _line(moment: dict[str, Any]) -> str:
    """A movement as the log holds it."""
    strongest_dbm = max(sum(trace) / len(trace) for trace in zip(*moment["rssi_dbm"], strict=True))
    displacement = "(" + ", ".join(f"{metres:+.0f}" for metres in moment["displacement_m"]) + ")"
    center = "(" + ", ".join(f"{coordinate:+4.0f}" for coordinate in moment["center_m"]) + ")"
    return (
        f"{moment['movement']:4d} {displacement if moment['movement'] > 0 else 'start':>12} m  centre {center} m  "
        f"spacing {moment['spacing_m']:g} m  strongest {strongest_dbm:6.1f} dBm  "
        f"target {moment['distance_m']:5.1f} m away" + ("  reached" if moment["reached"] else "")
    )


def _summary(log: dict[str, Any]) -> Table:
    table = Table(show_header=False)
    table.add_row("Ending", "target reached" if log["reached"] else "target not reached")
    table.add_row("Movements", f"{log['movements']}")
    table.add_row("Final distance", f"{log['final_distance_m']:.2f} m")
    table.add_row("Path flown", f"{log['path_length_m']:.0f} m")
    for speed, seconds in log["tracking_time_s"].items():
        table.add_row(f"Tracking time at {speed} m/s", f"{seconds:.0f} s")
    return table
