"""``swarmchase keys``: new secret keys for the live link."""

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from .terminal import CONSOLE, print_json


@dataclass(frozen=True, kw_only=True)
class KeysCommand:
    """Write a file with a new key for each of the six trackers, which only its owner can read."""

    file: Positional[Path]
    """Must not exist. The controller reads it as it is; each tracker needs its own line only."""
    json: bool = False
    """Print one JSON object on standard output: the file and the trackers, no key."""

    def run(self) -> None:
        """Make and write the keys."""
        from ..live.link.keys import new_keys, write_keys

        keys = new_keys()
        write_keys(self.file, keys)
        if self.json:
            print_json({"file": str(self.file), "trackers": sorted(keys)})
        else:
            CONSOLE.print(f"Keys of {len(keys)} trackers are in {self.file}.", markup=False, soft_wrap=True)
