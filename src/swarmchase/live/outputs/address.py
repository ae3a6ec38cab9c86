"""From what a person writes to an output."""

import importlib

from ..address import kind_and_place
from .kind import KINDS, OutputDetails
from .protocol import Output


def open_output(text: str, details: OutputDetails) -> Output:
    """The output of ``cot-udp:239.2.3.1:6969`` and so on: ``KINDS``. Its address need not be there yet.

    Raises:
        InputError: there is no such output, or it lacks a detail or a package.
    """
    kind, place = kind_and_place(text, KINDS, "output")
    module, name = kind.home.split(".")
    opened: Output = getattr(importlib.import_module(f".{module}", __package__), name)(place, details)
    return opened
