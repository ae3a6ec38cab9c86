"""``swarmchase serve``: the controller service, for trackers that dial in."""

import contextlib
import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError
from ..live.service.limit_values import LimitValues
from ..scenario import NUM_TRACKERS
from .configuration import ConfigurationOptions
from .link_options import LinkOptions, fields_from
from .options import DEFAULT_CONTROLLER, ListeningControllerName, ScenarioOptions, ServiceOptions, explain_choice
from .output_options import OutputOptions
from .terminal import line_printer, print_json

if TYPE_CHECKING:
    from ..controllers import Controller
    from ..live.service.safety import SafetyLimits
    from ..scenario import Scenario

STANDARD_INPUT = 0


@dataclass(frozen=True, kw_only=True)
class ServeCommand(LimitValues, ServiceOptions, ScenarioOptions, LinkOptions, OutputOptions, ConfigurationOptions):
    """Command real trackers until the target is reached. Standard input takes a word a line: start, override
    (begin although the preflight has not passed), hold, resume, reached (you see the target), abort, quit. Ctrl-C
    aborts: trackers are told to hold."""

    controller: ListeningControllerName = DEFAULT_CONTROLLER
    listen: str = "127.0.0.1:14550"
    """HOST:PORT that trackers dial, UDP."""
    start: bool = False
    """Begin as soon as trackers are there; otherwise the word start begins."""
    stay: bool = False
    """When the target is reached or the movements are spent, go on holding the trackers there until abort or quit.
    Without it the service ends, and they do what they do without a controller."""
    seed: int = 0
    """Of the controller's own random choices."""
    page: str | None = None
    """HOST:PORT of a page to watch and command the chase; beyond this machine its address holds a token."""
    log: Path | None = None
    """A new .mcap file for the log; swarmchase replay shows it."""
    json: bool = False
    """Print how the chase ended as one JSON object on standard output."""

    def run(self) -> None:
        """Serve, and say how it ended."""
        from ..live.address import host_and_port
        from ..live.link.mavlink import ControllerMavlinkLink
        from ..live.link.state_file import CONTROLLER_FILE
        from ..live.service.operator_words import OperatorWords
        from ..live.service.service import require_judged
        from ..live.service.state_folder import next_epoch
        from ..live.session import Assignment, Session
        from ..processes.stop_request import stop_request

        host, port = host_and_port(self.listen, "--listen")
        scenario, limits, settings, keys = self.world(), self.limits(), self.settings(), self.read_keys()
        controller = ready_controller(self.controller, scenario, self.seed)
        require_judged(scenario, controller, settings)
        audience = self.audience(self.page, self.log, is_simulated=False)
        assignment = Assignment(scenario, self.controller, self.seed, 0, limits, settings, audience)
        folder = self.folder()
        with line_printer() as tell, stop_request() as request:
            # The state file keeps a second service of this folder out; so nobody else takes the same epoch.
            state_path = folder / CONTROLLER_FILE
            link = ControllerMavlinkLink(host, port, keys, state_path=state_path, unsigned=self.unsigned)
            with contextlib.closing(link):
                epoch = next_epoch(folder / "controller.epoch")
                with contextlib.closing(Session(assignment, controller, link, epoch, tell)) as session:
                    tell("Listening on {}:{}, ".format(*link.address) + f"controller {controller.name}, epoch {epoch}.")
                    if not self.start:
                        tell("Waiting for the word start.")
                    words = [OperatorWords(STANDARD_INPUT).read]
                    summary = session.run(words, request, starts=self.start, stay=self.stay)
            tell(f"Ended {summary.state} after {summary.movements} movements: {summary.reason}.")
        if self.json:
            print_json(dataclasses.asdict(summary))

    def limits(self) -> "SafetyLimits":
        """The safety limits that the options say."""
        from ..live.service.safety import SafetyLimits

        return SafetyLimits(**fields_from(self, SafetyLimits))


def ready_controller(name: str, scenario: "Scenario", seed: int) -> "Controller":
    """A controller for real trackers, loaded, and asked once: the first time takes longest.

    Raises:
        InputError: there is none of this name, or it needs to know the target.
    """
    import torch

    from ..controllers import load_controller
    from ..controllers.oracle import ORACLES
    from ..formation import tracker_position_m
    from ..observation import Observation

    if name in ORACLES:
        raise InputError(f"the {name} knows where a simulated target is; real ones do not tell")
    explain_choice(name, scenario)
    controller = load_controller(name, scenario)
    place_m = tracker_position_m(torch.zeros(1, 3, dtype=torch.float64), torch.tensor([3.0], dtype=torch.float64))
    rssi_dbm = torch.full((1, scenario.samples_a_decision, NUM_TRACKERS), -70.0)
    observation = Observation(rssi_dbm, place_m[:, None].expand(-1, scenario.samples_a_decision, -1, -1))
    controller.decide(observation, controller.begin(1, seed))
    return controller
