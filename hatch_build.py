"""What a wheel holds of the weights: each file packed, and of some the name alone. An editable installation has all."""

import lzma
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

WEIGHTS = "src/swarmchase/weights"
FILTERS = [{"id": lzma.FILTER_LZMA2, "preset": 6, "lc": 0, "lp": 1, "pb": 1}]
"""For numbers of two bytes; three networks of a file may be the same, and so far apart that a wheel's own compression
does not see it."""


class PackedWeights(BuildHookInterface[Any]):
    """``left-out`` in its table in pyproject.toml names what the wheel does without."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Put packed files in the place of the weights, which the wheel excludes."""
        if version == "editable":
            return
        self._folder = tempfile.TemporaryDirectory()
        for path in sorted(Path(self.root, WEIGHTS).glob("*/*.safetensors")):
            name = f"{path.parent.name}/{path.stem}"
            is_left_out = name in self.config["left-out"]
            packed = Path(self._folder.name) / name.replace("/", "-")
            packed.write_bytes(b"" if is_left_out else lzma.compress(path.read_bytes(), filters=FILTERS))
            place = f"swarmchase/weights/{name}.safetensors{'.left-out' if is_left_out else '.xz'}"
            build_data["force_include"][str(packed)] = place

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what was made for the wheel."""
        if version != "editable":
            self._folder.cleanup()
