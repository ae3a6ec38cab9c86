"""The estimate in a new file, a JSON object a line."""

from pathlib import Path

from ...files import new_file
from ..frame import Frame
from .kind import OutputDetails
from .remote_id import estimate_message


class JsonLinesOutput:
    """One file, which others may read while it grows.

    Raises:
        InputError: it exists already, or cannot be made.
    """

    def __init__(self, place: str, details: OutputDetails) -> None:
        self._details = details
        self._path = Path(place)
        self._file = new_file(self._path, "output", buffering=0)

    def send(self, frame: Frame, wall_ns: int) -> None:
        """One line, whole or not at all.

        Raises:
            OSError: the disk is full or gone.
        """
        end = self._file.tell()
        try:
            self._file.write(estimate_message(frame, wall_ns, self._details) + b"\n")
        except OSError:
            self._file.truncate(end)
            self._file.seek(end)
            raise

    def close(self) -> None:
        """End the file; one without a line, of a chase that never began, is none."""
        if not self._file.tell():
            self._path.unlink(missing_ok=True)
        self._file.close()
