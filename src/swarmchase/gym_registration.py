"""The name of the chase for ``gymnasium.make``. Importing this registers it and imports nothing heavy.

Gymnasium 1 finds no environments by itself (its plugin entry points are gone), so the import must be asked for: once
in a program, or in the name, ``gymnasium.make("swarmchase.gym:swarmchase/Chase-v0")``.
"""

import gymnasium

ENVIRONMENT_ID = "swarmchase/Chase-v0"


def register_environments() -> None:
    """Register the chase, single and vectorised. A second call changes nothing."""
    if ENVIRONMENT_ID not in gymnasium.registry:
        gymnasium.register(
            id=ENVIRONMENT_ID, entry_point="swarmchase.gym:ChaseEnv", vector_entry_point="swarmchase.gym:ChaseVectorEnv"
        )


register_environments()
