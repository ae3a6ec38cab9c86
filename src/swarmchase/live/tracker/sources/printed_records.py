"""Lines as people's sketches print them: JSON records (``json_records``), or text with a level (``sketch_text``)."""

from .json_records import LONGEST_EXAMPLE, LONGEST_LINE_BYTES, JsonRecords
from .kind import SourceDetails
from .protocol import Sample
from .rejected import Rejected
from .sketch_text import heard_in
from .transmitters import Transmitters


class PrintedRecords:
    """``LineRecords`` of both forms. Of lines that say whose transmission they are, only those of the device that is
    chased count.

    Raises:
        InputError: the address of the device that is chased is none.
    """

    longest_line_bytes = LONGEST_LINE_BYTES

    def __init__(self, details: SourceDetails) -> None:
        self.rejected = Rejected()
        self._transmitters: Transmitters = details.transmitters()
        self._json = JsonRecords(details, self.rejected, self._transmitters)

    def sample(self, line: bytes, now_ns: int) -> Sample | None:
        """The sample in the line; None where there is none."""
        if line.lstrip()[:1] in (b"{", b"["):
            return self._json.sample(line, now_ns)
        heard = heard_in(line[:LONGEST_LINE_BYTES].decode(errors="replace"))
        if heard is None:
            self.rejected.add("no level in it", line.strip()[:LONGEST_EXAMPLE].decode(errors="replace"))
            return None
        sender = heard.mac or heard.name
        if sender is not None and not self._transmitters.counts(
            sender, [heard.name] if heard.name else [], heard.rssi_dbm
        ):
            self.rejected.add("of another transmitter", sender)
            return None
        return now_ns, heard.rssi_dbm

    def require_one(self, what: str, now_ns: int) -> None:
        """Ask whose transmissions are meant.

        Raises:
            InputError: several transmit, and none was chosen.
        """
        self._transmitters.require_one_in_time(what, now_ns)
