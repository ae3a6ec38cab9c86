"""Draws the scenarios and the behaviours in docs/moving.md from real chases: python docs/scenario_pictures.py

All are chases of seed 0 by ``oracle``; it takes some seconds.
"""

import argparse
import dataclasses
from pathlib import Path
from typing import Any

from swarmchase.controllers import load_controller
from swarmchase.evaluation.chase_log import chase_log, run_chase
from swarmchase.reports.scenarios import draw_behaviours, draw_scenarios
from swarmchase.scenario import SHIPPED_SCENARIOS, Scenario, load_scenario
from swarmchase.world.behaviours import behaviour_names

FIGURES = Path(__file__).parent / "figures"
CHASES = range(8)
"""Of each scenario, the targets of the moving ones flying between waypoints."""
CHASE = 12
"""Of each behaviour."""


def main() -> None:
    """Chase and draw."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--folder", type=Path, default=FIGURES, help="where the pictures go")
    folder = options.parse_args().folder
    worlds = {name: load_scenario(name) for name in SHIPPED_SCENARIOS}
    flight = worlds["flight"]
    logs = {
        name: [
            log_of(world if name == "paper" else dataclasses.replace(world, behaviour="waypoints"), chase)
            for chase in CHASES
        ]
        for name, world in worlds.items()
    }
    draw_scenarios(logs, folder / "scenarios.png", f"{', '.join(logs)}: chases 0 to {CHASES[-1]} of seed 0 by oracle")
    flown = {name: log_of(dataclasses.replace(flight, behaviour=name), CHASE) for name in behaviour_names()}
    title = f"Behaviours at {flight.target_speed_mps:g} m/s: chase {CHASE} of seed 0 by oracle"
    draw_behaviours(flown, folder / "behaviours.png", title)


def log_of(scenario: Scenario, chase: int) -> dict[str, Any]:
    """Of one chase by the oracle."""
    oracle = load_controller("oracle", scenario)
    return chase_log(scenario, oracle, 0, chase, list(run_chase(scenario, oracle, 0, chase)))


if __name__ == "__main__":
    main()
