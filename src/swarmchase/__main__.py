"""``python -m swarmchase`` is ``swarmchase``."""

from .cli import main

main()
