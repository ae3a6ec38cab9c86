"""Where ``swarmchase-tracker`` begins: one command, in a distribution of its own for a small computer (tracker/)."""

import sys
from collections.abc import Sequence

from . import __version__
from .processes.ctrl_c import end_silently

PROGRAM = "swarmchase-tracker"


def main(arguments: Sequence[str] | None = None) -> None:
    """Be the tracker of the command line, as ``swarmchase tracker`` is."""
    end_silently()
    from .commands.running import exit_codes, parsed, run
    from .commands.tracker import TrackerCommand
    from .processes.stop_request import stopped_at_once

    words = list(sys.argv[1:] if arguments is None else arguments)
    with exit_codes():
        if words[:1] == ["--version"]:
            print(f"{PROGRAM} {__version__}", flush=True)
            return
        command = parsed(TrackerCommand, PROGRAM, words)
        with stopped_at_once():
            run(command)
