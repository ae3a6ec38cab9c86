"""The tracker of swarmchase by itself: one command, for a small computer beside a receiver.

``modules/`` holds those modules of the package ``swarmchase`` that the command imports, under their own names: what
plugs into ``swarmchase tracker`` plugs in here, too. They lie in a folder that only this command looks into, so that
both distributions can be installed side by side: no file belongs to two.
"""

import sys
from pathlib import Path

MODULES = Path(__file__).parent / "modules"


def main() -> None:
    """Be the tracker of the command line."""
    sys.path.insert(0, str(MODULES))
    from swarmchase.tracker_alone import main as run

    run()
