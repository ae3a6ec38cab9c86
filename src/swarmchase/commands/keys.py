"""``swarmchase keys`` and its like: the secret keys of the live link, and what its ends remember of each other."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from ..errors import InputError
from .terminal import CONSOLE, print_json

CONTROLLER = "controller"


@dataclass(frozen=True, kw_only=True)
class KeysCommand:
    """Write a file with a new key for each of the six trackers, which only its owner can read. See also: swarmchase
    keys renew, keys revoke and keys reset."""

    file: Positional[Path]
    """Must not exist. The controller reads it as it is; each tracker needs its own line only."""
    json: bool = False
    """Print one JSON object on standard output: the file and the trackers, no key."""

    def run(self) -> None:
        """Make and write the keys."""
        from ..live.link.keys import new_keys, write_keys

        keys = new_keys()
        write_keys(self.file, keys)
        _say(self.json, f"Keys of {len(keys)} trackers are in {self.file}.", file=str(self.file), trackers=sorted(keys))


@dataclass(frozen=True, kw_only=True)
class KeysOfOneCommand:
    """What the two below share."""

    file: Positional[Path]
    """The controller's key file. It is replaced whole; a service that runs has read the old one."""
    tracker: Positional[int]
    """0 to 5."""
    json: bool = False
    """Print one JSON object on standard output: the file and the trackers that have keys now, no key."""

    def _say(self, line: str) -> None:
        from ..live.link.keys import read_keys

        _say(self.json, line, file=str(self.file), trackers=sorted(read_keys(self.file)))


@dataclass(frozen=True, kw_only=True)
class KeysRenewCommand(KeysOfOneCommand):
    """Give one tracker a new key: its old one may be known to others. The other keys stay as they are."""

    def run(self) -> None:
        """Renew it, and say what is to be done."""
        from ..live.link.keys import renew_key

        renew_key(self.file, self.tracker)
        self._say(
            f"Tracker {self.tracker} has a new key in {self.file}: give it its line, and start it and swarmchase serve "
            "again."
        )


@dataclass(frozen=True, kw_only=True)
class KeysRevokeCommand(KeysOfOneCommand):
    """Take one tracker's key out: the controller listens to it no more. The other keys stay as they are."""

    def run(self) -> None:
        """Revoke it, and say what is to be done."""
        from ..live.link.keys import revoke_key

        revoke_key(self.file, self.tracker)
        self._say(f"Tracker {self.tracker} has no key in {self.file} any more: start swarmchase serve again.")


@dataclass(frozen=True, kw_only=True)
class KeysResetCommand:
    """Forget on this machine when one sender has signed last: for a clock that was ahead, and is right again. Nothing
    that uses the state folder may run."""

    sender: Annotated[Positional[str], arg(metavar="SENDER", help="A tracker, 0 to 5, or controller.")]
    state_folder: Path | None = None
    """What serve or tracker was given; default is $XDG_STATE_HOME/swarmchase or ~/.local/state/swarmchase."""
    json: bool = False
    """Print one JSON object on standard output: the sender and the files that were changed."""

    def run(self) -> None:
        """Reset it, and say where."""
        from ..live.link.codec import CONTROLLER_SYSTEM, system_of
        from ..live.link.state_file import reset_sender, sender_name
        from ..live.service.state_folder import default_state_folder
        from ..scenario import NUM_TRACKERS

        systems = {str(tracker): system_of(tracker) for tracker in range(NUM_TRACKERS)}
        systems[CONTROLLER] = CONTROLLER_SYSTEM
        if self.sender not in systems:
            raise InputError(f"sender {self.sender!r} is refused: allowed is one of {', '.join(systems)}")
        folder = default_state_folder() if self.state_folder is None else self.state_folder
        files = [str(path) for path in reset_sender(folder, systems[self.sender])]
        name = sender_name(systems[self.sender])
        _say(self.json, f"Forgotten: when {name} has signed last, in {', '.join(files)}.", sender=name, files=files)


def _say(as_json: bool, line: str, **document: Any) -> None:
    if as_json:
        print_json(document)
    else:
        CONSOLE.print(line, markup=False, soft_wrap=True)
