"""``swarmchase replay``: a recorded chase on the page, asked again, as a report, exported, or as JSON."""

import dataclasses
import math
import sys
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tyro.conf import Positional

from ..errors import InputError
from ..files import require_writable_file, write_text_atomically
from .terminal import CONSOLE, print_json

if TYPE_CHECKING:
    from ..live.frame import Frame
    from ..live.log.recording import Recording
    from ..live.log.verification import Verification

GEOJSON = ".geojson"
EXPORTS = (GEOJSON, ".csv")
LOOK_S = 0.1
MOST_ROWS = 20


@dataclass(frozen=True, kw_only=True)
class ReplayCommand:
    """Show a recorded chase on a page, until Ctrl-C. With --verify, --report, --export or --json there is no page."""

    file: Positional[Path]
    """The log: an .mcap file of swarmchase serve; one that was cut short will do."""
    page: str = "127.0.0.1:8800"
    """HOST:PORT of the page; beyond this machine its address holds a token."""
    verify: bool = False
    """Ask the recorded controller again what it was asked, and compare the actions bit for bit. Exit code 1 if any is
    another one."""
    report: bool = False
    """Write one HTML page of the chase beside the log, with the ending .html: a drawing, and what has happened."""
    export: Path | None = None
    """Write the chase to this file, .geojson (ways on the earth) or .csv (a row a frame)."""
    global_origin: tuple[float, float, float] | None = None
    """Latitude and longitude in degrees, altitude in m above sea level where x, y, z are 0; default is what the log
    says. For --export."""
    geoid_height_m: float = 0.0
    """Of the sea level above the ellipsoid of WGS 84 there; for --export."""
    overwrite: bool = False
    """Replace files that --report or --export would write and that are there already."""
    json: bool = False
    """Print what the log holds as one JSON object on standard output."""

    def run(self) -> None:
        """Read the log, and do with it what the options say."""
        from ..live.log.recording import read_recording
        from ..live.log.verification import verify

        report_path = self.file.with_suffix(".html")
        if self.report:
            require_writable_file(report_path, replaces=self.overwrite)
        if self.export is not None:
            if self.export.suffix not in EXPORTS:
                raise InputError(f"--export {self.export} is refused: allowed is one of {', '.join(EXPORTS)}")
            require_writable_file(self.export, replaces=self.overwrite)
        recording = read_recording(self.file)
        _tell_contents(recording)
        verification = verify(recording) if self.verify else None
        if verification is not None:
            _tell_verification(verification)
        if self.report:
            _write_report(recording, report_path)
        if self.export is not None:
            self._write_export(recording, self.export)
        if self.json:
            print_json(_contents(recording, verification))
        if verification is None and not (self.json or self.report or self.export):
            self._show(recording)
        elif verification is not None and not verification.is_same:
            sys.exit(1)

    def _write_export(self, recording: "Recording", path: Path) -> None:
        from ..live.earth import EarthOrigin
        from ..live.outputs.csv_table import csv_table
        from ..live.outputs.geojson import geojson
        from ..live.outputs.kind import OutputDetails

        origin = recording.head.origin if self.global_origin is None else EarthOrigin(*self.global_origin)
        details = OutputDetails(origin, self.geoid_height_m)
        if path.suffix == GEOJSON:
            details.require_origin(f"--export {path}")
        if not recording.num_frames:
            raise InputError(f"the log {self.file} has no frames to export")
        export = geojson if path.suffix == GEOJSON else csv_table
        write_text_atomically(path, export(recording.head, recording.frames(), details))
        _tell(f"The export is {path}.")

    def _show(self, recording: "Recording") -> None:
        """The page is there at once; a long log takes some seconds to be all there."""
        from ..live.address import host_and_port
        from ..live.page.feed import Feed
        from ..live.page.info import page_info
        from ..live.page.server import PageServer
        from ..live.page.token import new_token
        from ..processes.stop_request import stop_request

        if not recording.num_frames:
            raise InputError(f"the log {self.file} has no frames to show; --verify and --json work without")
        host, port = host_and_port(self.page, "--page")
        feed = Feed(page_info(recording.head) | {"duration_s": round(recording.seconds, 3)}, is_live=False)
        with stop_request() as request:
            server = PageServer(feed, host, port, new_token(host))
            try:
                _tell(f"The page is at {server.url}; Ctrl-C ends it.")
                for frame in recording.frames():
                    feed.publish(frame)
                    if request.made:
                        return
                while not request.made:
                    time.sleep(LOOK_S)
            finally:
                server.close()


def _write_report(recording: "Recording", path: Path) -> None:
    from ..reports.recorded_chase import RecordedEvent, recorded_chase_picture
    from ..reports.recorded_chase_page import recorded_chase_page

    head = recording.head
    events = [
        RecordedEvent((event.time_ns - head.began_ns) / 1e9, event.severity.value, event.text)
        for event in recording.events
    ]
    title = (
        f"Chase {head.chase} of seed {head.seed} by {Path(head.controller).name}, "
        f"{head.started_at:%Y-%m-%d %H:%M:%S} UTC: {recording.state.value} after {recording.seconds:.1f} s"
    )
    try:
        picture = recorded_chase_picture(recording.frames(), events, title, head.scenario.success_radius_m)
    except ValueError:
        raise InputError(
            f"in the log {recording.path} there is nothing to draw: the swarm has no place in it"
        ) from None
    last = deque(recording.frames(), maxlen=1).pop()
    told = [event for event in events if event.severity != "routine"]
    page = recorded_chase_page(title, picture, _facts(recording, last), _trackers(last), told, _settings(recording))
    write_text_atomically(path, page)
    _tell(f"The report is {path}.")


def _facts(recording: "Recording", last: "Frame") -> dict[str, str]:
    """How it went."""
    facts = {
        "ending": recording.state.value + (f": {recording.reason}" if recording.reason else ""),
        "movements": f"{recording.movements}",
        "seconds": f"{recording.seconds:.1f}",
    }
    estimate, following = last["estimate"], last["following"]
    if estimate is not None:
        radius = "" if estimate["radius_m"] is None else f", 95 % within {estimate['radius_m']:.1f} m"
        facts["target, as believed at the end"] = (
            f"{estimate['distance_m']:.1f} m away, bearing {estimate['bearing_deg']:.0f} degrees{radius}"
        )
    if last["target_m"] is not None and last["center_m"] is not None:
        facts["simulated target at the end"] = f"{math.dist(last['target_m'], last['center_m']):.2f} m from the centre"
    if following is not None:
        facts["followed"] = (
            f"{following['share']:.0%} of {following['seconds']:.0f} s within {following['within_m']:g} m"
        )
    if last["rejected"]:
        facts["datagrams rejected"] = ", ".join(f"{count} {reason}" for reason, count in last["rejected"].items())
    if recording.lost_frames or recording.lost_entries:
        facts["lost by the recorder"] = f"{recording.lost_frames} frames, {recording.lost_entries} entries"
    if recording.is_cut:
        facts["the log is not whole"] = recording.cut
    return facts


def _trackers(last: "Frame") -> list[dict[str, str]]:
    return [
        {
            "tracker": f"{number}",
            "condition": tracker["condition"] + (f": {tracker['left_out']}" if tracker["left_out"] else ""),
            "mode": tracker["mode"] or "-",
            "place (m)": "-"
            if tracker["position_m"] is None
            else "{:.1f}, {:.1f}, {:.1f}".format(*tracker["position_m"]),
            "packets lost": "-" if tracker["loss_share"] is None else f"{tracker['loss_share']:.0%}",
            "samples missing": f"{tracker['missing_share']:.0%}",
            "no levels": ", ".join(f"{count} {reason}" for reason, count in tracker["dropped"].items()) or "-",
        }
        for number, tracker in enumerate(last["trackers"])
    ]


def _settings(recording: "Recording") -> dict[str, dict[str, str]]:
    """What it was run with."""
    head = recording.head
    run = {
        "controller": head.controller,
        "weights (SHA-256)": head.weights_sha256 or "none",
        "swarmchase": head.version,
        "log": str(recording.path),
    }
    if head.origin is not None:
        run["origin"] = "latitude {:g}, longitude {:g}, altitude {:g} m".format(*dataclasses.astuple(head.origin))
    limits = {name: f"{value:g}" for name, value in dataclasses.asdict(head.limits).items()}
    scenario = {name: str(value) for name, value in head.scenario.to_dict().items()}
    return {"Run": run, "Limits": limits, "Scenario": scenario}


def _tell(line: str) -> None:
    CONSOLE.print(line, markup=False, soft_wrap=True)


def _tell_contents(recording: "Recording") -> None:
    head = recording.head
    _tell(
        f"Chase {head.chase} of seed {head.seed} by {head.controller}, {head.started_at:%Y-%m-%d %H:%M:%S} UTC: "
        f"{recording.state.value} after {recording.movements} movements and {recording.seconds:.1f} s"
        f"{f' ({recording.reason})' if recording.reason else ''}."
    )
    if recording.is_cut:
        _tell(f"The log is not whole: {recording.cut}. What comes before is here.")
    if recording.lost_frames or recording.lost_entries:
        frames, entries = recording.lost_frames, recording.lost_entries
        _tell(f"The recorder has lost {frames} frames and {entries} transitions, decisions and events.")
    for event in recording.events:
        if event.severity != "routine":
            _tell(f"{(event.time_ns - head.began_ns) / 1e9:7.1f} s  {event.text}")


def _tell_verification(verification: "Verification") -> None:
    from rich.table import Table

    for doubt in verification.doubts:
        _tell(f"Note: {doubt}.")
    different = len(verification.mismatches)
    if not different:
        _tell(f"All {verification.decisions} decisions are the same, bit for bit.")
        return
    _tell(f"{different} of {verification.decisions} decisions are different:")
    table = Table("decision", "movement", "spacing and displacement recorded", "now")
    for mismatch in verification.mismatches[:MOST_ROWS]:
        now = mismatch.reason if mismatch.now is None else _words(mismatch.now)
        table.add_row(str(mismatch.number), str(mismatch.movement), _words(mismatch.recorded), now)
    CONSOLE.print(table, markup=False)
    if different > MOST_ROWS:
        _tell(f"and {different - MOST_ROWS} more; --json has them all.")


def _words(action: tuple[float, ...]) -> str:
    return " ".join(map(repr, action))


def _contents(recording: "Recording", verification: "Verification | None") -> dict[str, Any]:
    from ..live.log.entries import event_form

    head = recording.head
    contents: dict[str, Any] = {
        "file": str(recording.path),
        "version": head.version,
        "controller": head.controller,
        "sampling_hz": head.scenario.sampling_hz,
        "spatial_correlation": head.scenario.spatial_correlation,
        "seed": head.seed,
        "chase": head.chase,
        "epoch": head.epoch,
        "started_at": head.started_at.isoformat(),
        "state": recording.state.value,
        "reason": recording.reason,
        "movements": recording.movements,
        "seconds": round(recording.seconds, 3),
        "transitions": len(recording.transitions),
        "decisions": len(recording.decisions),
        "events": [event_form(event) for event in recording.events],
        "frames": recording.num_frames,
        "lost_frames": recording.lost_frames,
        "lost_entries": recording.lost_entries,
        "is_cut": recording.is_cut,
        "cut": recording.cut,
    }
    if verification is not None:
        contents |= {
            "is_same": verification.is_same,
            "doubts": list(verification.doubts),
            "mismatches": [_json_of(mismatch) for mismatch in map(dataclasses.asdict, verification.mismatches)],
        }
    return contents


def _json_of(mismatch: dict[str, Any]) -> dict[str, Any]:
    """What is no finite number is a word, as JSON has none for it."""
    for name in ("recorded", "now"):
        if mismatch[name] is not None:
            mismatch[name] = [value if math.isfinite(value) else repr(value) for value in mismatch[name]]
    return mismatch
