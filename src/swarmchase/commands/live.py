"""``swarmchase live``: the whole live system on this machine, with a simulated target."""

import dataclasses
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from ..errors import InputError
from ..files import require_writable_folder
from .options import DEFAULT_CONTROLLER, ListeningControllerName, ScenarioOptions, ServiceOptions
from .output_options import OutputOptions
from .terminal import CONSOLE, line_printer, print_json

if TYPE_CHECKING:
    from ..simulation.live_chase import LiveSummary

STANDARD_INPUT = 0


@dataclass(frozen=True, kw_only=True)
class LiveCommand(ServiceOptions, ScenarioOptions, OutputOptions):
    """Chase a simulated target with six tracker processes, a link that can fail, the controller service and its page,
    in real time. Standard input takes the words of swarmchase serve: override, hold, resume, reached, abort,
    quit."""

    controller: ListeningControllerName = DEFAULT_CONTROLLER
    seed: int = 0
    """Seed of the run the chase belongs to."""
    chase: int = 0
    """Number of the chase in its run: the target and the channel are those of swarmchase evaluate."""
    faults: str = ""
    """What is to go wrong, such as loss=0.15,silent=2@10-20,restart=4@30; docs/live.md has the words."""
    page: str = "127.0.0.1:8800"
    """HOST:PORT of the page."""
    headless: bool = False
    """No page."""
    log: Path | None = None
    """A new file for the log; default is one named after the time, in live-output/."""
    json: bool = False
    """Print how the chase ended as one JSON object on standard output."""

    def run(self) -> None:
        """Chase, and say how it ended."""
        from ..live.service.operator_words import OperatorWords
        from ..live.service.service import require_judged
        from ..live.session import Assignment
        from ..processes.stop_request import stop_request
        from ..simulation.fault_plan import fault_plan
        from ..simulation.live_chase import run_live_chase
        from ..simulation.site import require_played, require_site, site_limits
        from .serve import ready_controller

        if self.seed < 0 or self.chase < 0:
            raise InputError(f"seed = {self.seed}, chase = {self.chase} is refused: both must be at least 0")
        plan, scenario = fault_plan(self.faults), self.world()
        require_site(scenario)
        require_played(scenario, plan)
        settings, name = self.settings(), self.controller
        controller = ready_controller(name, scenario, self.seed)
        require_judged(scenario, controller, settings)
        audience = self.audience(None if self.headless else self.page, self._log_path(), is_simulated=True)
        assignment = Assignment(scenario, name, self.seed, self.chase, site_limits(scenario), settings, audience)
        words = [OperatorWords(STANDARD_INPUT).read]
        with line_printer() as tell, stop_request() as request:
            summary = run_live_chase(assignment, plan, controller, words, request, tell, linger=not self.headless)
        CONSOLE.print(_table(summary))
        CONSOLE.print(f"See it again: swarmchase replay {audience.log}", markup=False, soft_wrap=True)
        if self.json:
            origin = {"controller": name, "seed": self.seed, "chase": self.chase, "faults": self.faults}
            print_json(origin | dataclasses.asdict(summary) | {"log": str(audience.log)})

    def _log_path(self) -> Path:
        if self.log is not None:
            return self.log
        folder = Path("live-output")
        require_writable_folder(folder)
        return folder / f"{datetime.now():%Y%m%d-%H%M%S}-seed{self.seed}-chase{self.chase}.mcap"


def _table(summary: "LiveSummary") -> Table:
    table = Table(show_header=False)
    table.add_row("Ending", f"{summary.state}: {summary.reason}")
    table.add_row("Target", f"{summary.distance_m:.2f} m from the centre" + ("; reached" if summary.reached else ""))
    if summary.following_share is not None:
        truly = f" (truly {summary.true_following_share:.0%})" if summary.true_following_share is not None else ""
        table.add_row("Followed", f"{summary.following_share:.0%} of the time since it was reached{truly}")
    table.add_row("Movements", f"{summary.movements}")
    table.add_row("Seconds", f"{summary.seconds:.0f}")
    if summary.decision_latency_p99_ms is not None:
        table.add_row("Decision, 99 % within", f"{summary.decision_latency_p99_ms:.1f} ms")
    rejected = ", ".join(f"{count} {reason}" for reason, count in summary.rejected.items())
    table.add_row("Datagrams rejected", rejected or "none")
    return table
