"""``swarmchase WORDS...`` as a process that ends with process PARENT, which starts it.

python -m swarmchase.processes.child_command PARENT WORDS...
"""

import runpy
import sys

from .children import end_with


def _run(parent: int, words: list[str]) -> None:
    end_with(parent)
    sys.argv = ["swarmchase", *words]
    runpy.run_module("swarmchase", run_name="__main__")


if __name__ == "__main__":
    _run(int(sys.argv[1]), sys.argv[2:])
