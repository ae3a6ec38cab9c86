"""Signal levels of captured 802.11 packets, from a capture file, finished or growing, or from a pipe.

    tcpdump -i wlan0mon -y IEEE802_11_RADIO -U -w - | swarmchase tracker ...

pcap and pcapng with radiotap headers (link type 127), as tcpdump, dumpcap, Wireshark and Kismet write them.
"""

from collections.abc import Iterator
from pathlib import Path

from ....errors import InputError
from ....reading import opened
from .captured_levels import CapturedLevels
from .growing_file import READ_BYTES, GrowingFile
from .kind import SourceDetails, SourceKind
from .protocol import Row, Sample
from .rejected import Rejected
from .sender_clock import SenderClock
from .transmitters import Transmitters


class PcapSource:
    """Packets that are being captured: from a growing file, from where it ends now, or from a pipe (/dev/stdin).

    Args:
        transmitters: whose frames count; without it everybody's, of whom there may be one.

    Raises:
        InputError: the file cannot be opened or is no such capture; it holds several transmitters already, and none
            was chosen.
    """

    def __init__(self, path: Path, transmitters: Transmitters | None = None) -> None:
        self._what = f"capture {path}"
        self._path, self._transmitters = path, transmitters or Transmitters()
        self._levels = CapturedLevels(self._transmitters)
        self._clock = SenderClock()
        self._file = GrowingFile(path, "capture")
        try:
            # What a file holds already is not how strong the signal is now; but it says who is there.
            while held := self._file.held():
                self._levels.feed(held)
            self._transmitters.require_one(self._what)
        except InputError:
            self.close()
            raise
        self._levels.rejected = Rejected()

    @property
    def rejected(self) -> Rejected:
        """The packets that gave no level."""
        return self._levels.rejected

    @property
    def silence(self) -> str:
        """Nothing is captured."""
        return f"no packet has been captured in {self._path}"

    def read(self, now_ns: int) -> list[Sample]:
        """The levels of the packets that have come.

        Raises:
            InputError: this is no capture with radiotap headers; or several transmit, and none was chosen.
        """
        samples = self._levels.feed(self._file.come())
        self._transmitters.require_one_in_time(self._what, now_ns)
        return [(self._clock.local_ns(time_ns, now_ns), level_dbm) for time_ns, level_dbm in samples]

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def pcap_rows(path: Path, transmitters: Transmitters | None = None) -> Iterator[Row]:
    """The levels of a finished capture, for ``ReplaySource``. It is read twice: the first time for who is in it.

    Raises:
        InputError: the file cannot be read, or is no capture with radiotap headers; several transmit in it and none was
            chosen, or the chosen one does not.
    """
    what, transmitters = f"capture {path}", transmitters or Transmitters()
    for _ in _read_through(path, transmitters):
        pass
    transmitters.require_one(what)
    transmitters.require_chased(what)
    yield from _read_through(path, transmitters)


def _read_through(path: Path, transmitters: Transmitters) -> Iterator[Row]:
    levels = CapturedLevels(transmitters)
    with opened(path, "recording") as file:
        while chunk := file.read(READ_BYTES):
            for time_ns, level_dbm in levels.feed(chunk):
                yield time_ns / 1e9, level_dbm


def _open(place: str, details: SourceDetails) -> PcapSource:
    return PcapSource(Path(place), details.transmitters())


KIND = SourceKind(scheme="pcap", place="FILE", note="pcap or pcapng that grows, or a pipe", open=_open)
