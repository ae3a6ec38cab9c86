"""What a controller that finds out the channel is told of a scenario."""

from ..scenario import Scenario

UNTOLD = (
    "receiver_offset_db",
    "missing_sample_share",
    "missing_burst_s",
    "silent_trackers",
    "behaviour",
    "target_speed_mps",
    "target_acceleration_mps2",
    "alert_distance_m",
    "transmit_power_error_db",
    "path_loss_exponent_error",
    "shadowing_db",
    "shadowing_distance_m",
    "shadowing_common_share",
    "ground_reflection",
    "transmit_duty",
    "frame_s",
    "silence_s",
    "between_silences_s",
    "silence_at_s",
    "receiver_step_db",
    "receiver_floor_dbm",
    "receiver_ceiling_dbm",
    "wrong_trackers",
    "stuck_trackers",
    "garbage_share",
    "follow_s",
)
"""What a simulation knows and nobody in the field does: how the channel and the receivers depart from what is told, and
what the target does, and how long a chase goes on when it was captured."""


def as_told(scenario: Scenario) -> Scenario:
    """The scenario as if its world had none of it: the same for all worlds that differ in nothing else."""
    return Scenario.from_dict({name: value for name, value in scenario.to_dict().items() if name not in UNTOLD})
