"""From what a person writes to a source of RSSI samples."""

from ...address import kind_and_place
from . import json_datagrams, json_lines, kismet, pcap, replay, serial_lines, simulated
from .kind import SourceDetails
from .protocol import RssiSource

KINDS = (
    replay.KIND,
    json_lines.KIND,
    serial_lines.KIND,
    json_datagrams.KIND,
    kismet.KIND,
    pcap.KIND,
    simulated.KIND,
)
"""Of all sources there are. A new one is a module that says its ``KIND``, and its name here."""


def open_source(text: str, details: SourceDetails) -> RssiSource:
    """The source of ``replay:FILE``, ``udp:PORT`` and so on: ``KINDS``.

    Raises:
        InputError: there is no such source, or it cannot be opened.
    """
    kind, place = kind_and_place(text, KINDS, "source")
    return kind.open(place, details)
