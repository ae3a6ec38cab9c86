"""Takes the pictures of the page in docs/live.md from real runs: python docs/pictures.py [--flight]

``swarmchase live`` chases a simulated target while a headless chromium has its page open; after some movements the
picture is taken. Needs chromium and Playwright (``pip install -e '.[dev]'``).
"""

import argparse
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

from PIL import Image

PICTURE, FLIGHT_PICTURE = (Path(__file__).parent / name for name in ("live-page.png", "live-flight.png"))
FLIGHT = ["--scenario", "flight", "--behaviour", "flee", "--target-speed-mps", "5", "--seed", "3"]
CHASE = ["--sampling-hz", "100", "--spatial-correlation", "0.5", "--seed", "1", "--controller", "particle"]
TROUBLE = "loss=0.03,silent=3@12,forge=20"
"""What makes a page worth looking at."""
CHROMIUM = ["--headless", "--no-sandbox", "--disable-gpu", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
STEPPING, IN_FLIGHT = 12, 50
"""Movements after which the pictures are taken."""
COLORS = 256
LOOK_MS = 200
SETTLED_MS = 1500
"""The camera has come to rest."""


def main() -> None:
    """Chase, and take the picture."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--flight", action="store_true", help="of a target that flees, heard in flight")
    options.add_argument("--out", type=Path, help="where the picture goes, if not into docs")
    options.add_argument("--movements", type=int, help="after which it is taken")
    options.add_argument("--size", type=int, nargs=2, default=(1280, 800), help="of the window, in pixels")
    chosen = options.parse_args()
    out = chosen.out or (FLIGHT_PICTURE if chosen.flight else PICTURE)
    movements = chosen.movements or (IN_FLIGHT if chosen.flight else STEPPING)
    log = out.with_suffix(".mcap")
    words = [sys.executable, "-m", "swarmchase", "live", *(FLIGHT if chosen.flight else CHASE), "--faults", TROUBLE]
    words += ["--page", "127.0.0.1:0", "--log", str(log)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    with subprocess.Popen(words, **pipes, text=True) as chase:
        try:
            take_picture(address_of(chase), out, movements, tuple(chosen.size))
        finally:
            chase.send_signal(signal.SIGINT)
            chase.communicate()
            log.unlink(missing_ok=True)


def address_of(chase: "subprocess.Popen[str]") -> str:
    """The page's, as the chase tells it."""
    assert chase.stderr is not None
    for line in chase.stderr:
        if found := re.search(r"The page is at (\S+)", line):
            return found[1]
    sys.exit("the chase has ended without a page")


def take_picture(address: str, out: Path, movements: int, size: tuple[int, int]) -> None:
    """Of the page at this address, once the chase has made so many movements."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=CHROMIUM)
        page = browser.new_page(viewport={"width": size[0], "height": size[1]}, color_scheme="dark")
        page.goto(address)
        while not (made := page.inner_text("#movements")).isdecimal() or int(made) < movements:
            page.wait_for_timeout(LOOK_MS)
        page.wait_for_timeout(SETTLED_MS)
        page.screenshot(path=out)
        browser.close()
    # A third of its size: a palette of what is in it.
    with Image.open(out) as picture:
        few = picture.convert("RGB").quantize(COLORS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
        few.save(out, optimize=True)


if __name__ == "__main__":
    main()
