"""Draws the picture in docs/moving.md from a real chase: python docs/moving_picture.py

It is the one that ``swarmchase chase`` leaves, and takes some seconds.
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

from swarmchase.files import atomic_path

PICTURE = Path(__file__).parent / "figures" / "moving-chase.png"
CHASE = "chase --scenario flight --behaviour jink --target-speed-mps 8 --controller oracle --chase 3"
"""As it stands in docs/moving.md."""


def main() -> None:
    """Chase, and keep the picture."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--out", type=Path, default=PICTURE, help="where the picture goes")
    chosen = options.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        words = [sys.executable, "-m", "swarmchase", *CHASE.split(), "--folder", folder]
        subprocess.run(words, check=True, stderr=subprocess.DEVNULL)
        with atomic_path(chosen.out) as temporary:
            temporary.write_bytes((Path(folder) / "chase.png").read_bytes())


if __name__ == "__main__":
    main()
