"""Names for ``gymnasium.make``. Gymnasium calls this when it is imported, so it must import nothing heavy."""

import gymnasium

ENVIRONMENT_ID = "swarmchase/Chase-v0"


def register_environments() -> None:
    """Register the chase, single and vectorised."""
    if ENVIRONMENT_ID not in gymnasium.registry:
        gymnasium.register(
            id=ENVIRONMENT_ID, entry_point="swarmchase.gym:ChaseEnv", vector_entry_point="swarmchase.gym:ChaseVectorEnv"
        )
