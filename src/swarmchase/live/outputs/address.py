"""From what a person writes to an output."""

from typing import TYPE_CHECKING

from ..address import kind_and_place
from .kind import OutputDetails, OutputKind

if TYPE_CHECKING:
    from .protocol import Output

KINDS = (
    OutputKind(
        scheme="cot-udp", place="HOST:PORT", note="Cursor-on-Target for ATAK and WinTAK", home="cot_udp.CotUdpOutput"
    ),
    OutputKind(scheme="cot-tcp", place="HOST:PORT", note="the same for a TAK server", home="cot_tcp.CotTcpOutput"),
    OutputKind(
        scheme="jsonl",
        place="FILE",
        note="the estimate in the terms of Remote ID, in a new file",
        home="json_lines.JsonLinesOutput",
    ),
    OutputKind(scheme="mqtt", place="HOST:PORT[/TOPIC]", note="the same to a broker", home="mqtt.MqttOutput"),
)
"""Of all outputs there are. A new one is a module beside this one, and its name here."""


def open_output(text: str, details: OutputDetails) -> "Output":
    """The output of ``cot-udp:239.2.3.1:6969`` and so on: ``KINDS``.

    Raises:
        InputError: there is no such output, or it lacks a detail or a package.
    """
    kind, place = kind_and_place(text, KINDS, "output")
    return kind.open(place, details)
