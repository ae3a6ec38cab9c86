"""``adaptive`` where it is told how high targets fly, and what it then believes."""

from dataclasses import replace

from swarmchase.controllers import load_controller
from swarmchase.controllers.adaptive import AdaptiveController
from swarmchase.controllers.belief import Believing
from swarmchase.evaluation.play import play
from swarmchase.scenario import paper_scenario


def test_no_particle_is_where_targets_do_not_fly() -> None:
    """The target is drawn anywhere: the height that is told is wrong, and stays believed."""
    scenario = paper_scenario(sampling_hz=10.0, max_movements=6)
    told = replace(scenario, lowest_altitude_m=48.0, highest_altitude_m=52.0)
    controller = load_controller("adaptive", told)
    assert isinstance(controller, AdaptiveController)
    assert isinstance(controller, Believing)
    memories = []
    decide = controller.decide

    def watched(*given):  # type: ignore[no-untyped-def]
        action, memory = decide(*given)
        memories.append(memory)
        return action, memory

    controller.decide = watched  # type: ignore[method-assign]
    for _ in play(scenario, controller, 1, range(2), 2):
        pass
    assert len(memories) >= 6
    for memory in memories:
        assert memory.position_m[:, 2].abs().max() <= 2
        assert controller.belief(memory).radius_m.isfinite().all()
