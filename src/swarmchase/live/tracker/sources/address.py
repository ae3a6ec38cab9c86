"""From what a person writes to a source of RSSI samples."""

from ....plug_ins import load_plug_in, plug_in_names
from ...address import kind_and_place
from . import (
    airodump,
    gnuradio,
    json_datagrams,
    json_lines,
    kismet,
    mqtt,
    pcap,
    radio_status,
    replay,
    rtl_power,
    serial_lines,
    simulated,
    zmq_records,
)
from .kind import SourceDetails, SourceKind
from .protocol import RssiSource

KINDS = (
    replay.KIND,
    json_lines.KIND,
    serial_lines.KIND,
    json_datagrams.KIND,
    mqtt.KIND,
    zmq_records.KIND,
    gnuradio.KIND,
    kismet.KIND,
    pcap.KIND,
    airodump.KIND,
    rtl_power.KIND,
    radio_status.KIND,
    simulated.KIND,
)
"""Of all sources there are. A new one is a module that says its ``KIND``, and its name here."""


def open_source(text: str, details: SourceDetails) -> RssiSource:
    """The source of ``replay:FILE``, ``udp:PORT`` and so on: ``KINDS``.

    Raises:
        InputError: there is no such source, or it cannot be opened.
    """
    kind, place = kind_and_place(text, [*KINDS, *_others(text)], "source")
    return kind.open(place, details)


def _others(text: str) -> list[SourceKind]:
    """What another package offers under the scheme of this address."""
    scheme = text.partition(":")[0]
    names = plug_in_names("sources")
    return [load_plug_in("sources", scheme, SourceKind)] if scheme in names else []
