"""A flight that the real service has flown: in its frames, on the page in a real browser, and drawn by the command."""

import base64
import dataclasses
import io
import math
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from page_contrast import (
    LEAST_CONTRAST,
    LEAST_CONTRAST_OF_LINES,
    PAINTED,
    SCHEMES,
    contrasts,
    contrasts_of_colors,
    places_painted,
)
from page_frames import FLIGHT, RecordedChase, ShownChase, flown_chase
from page_serving import served, until
from swarmchase.commands.replay import ReplayCommand
from swarmchase.errors import InputError
from swarmchase.live.chronicle import TRACK_S
from swarmchase.live.frame import Frame
from swarmchase.live.log.recorder import ChaseRecorder
from swarmchase.live.page.feed import Feed
from swarmchase.simulation.site import site_limits

CHROMIUM = shutil.which("chromium")
SOFTWARE = ["--headless", "--no-sandbox", "--disable-gpu", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
PHONE, SMALL, LARGE = (390, 844), (1280, 800), (1920, 1080)
PURSUED_S = 3.0
"""While the target is pursued."""
PATIENCE_MS = 60_000
SECOND_NS = 10**9
SETTLED_MS = 800
"""Views have come to rest."""
MAP_COLORS = ["belief", "target", "orange", "bright", "faint", *(f"tracker-{number}" for number in range(6))]
SEEN = [
    r"map: \d+ m",
    r"map: N",
    r"map: [0-5]",
    r"map: \d+ s",
    r"belief-chart: .+",
    r"traces: .+",
    r"predicted intercept",
    r"followed within 10 m",
    r"100 % of \d+ s",
    r"tracker 2 is silent",
    r"Target reached",
]
"""Of the texts of a flight, one of each kind."""


@pytest.fixture(scope="module")
def flight() -> RecordedChase:
    return flown_chase()


@pytest.fixture(scope="module")
def page(flight: RecordedChase) -> Iterator[Any]:
    """A browser's, with the recording; nothing may go wrong in it."""
    if CHROMIUM is None:
        pytest.skip("there is no chromium (Debian: apt-get install chromium)")
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed: pip install -e '.[dev]'"
    )
    feed = Feed(flight.info, is_live=False)
    for frame in flight.frames:
        feed.publish(frame)
    errors: list[str] = []
    with served(feed) as server, playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=SOFTWARE)
        page = browser.new_page(viewport={"width": SMALL[0], "height": SMALL[1]}, color_scheme="dark")
        page.set_default_timeout(PATIENCE_MS)
        page.on("console", lambda one: errors.append(one.text) if one.type == "error" else None)
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.add_init_script(PAINTED)
        page.goto(server.url)
        page.locator("#play").click()
        yield page
        browser.close()
    assert errors == []


def go_to(page: Any, time_s: float) -> None:
    page.locator("#slider").fill(f"{time_s:g}")
    until(lambda: abs(float(page.evaluate("document.body.dataset.timeS")) - time_s) < 0.11)


def half_way_s(flight: RecordedChase, state: str) -> float:
    """A moment at which the chase is in this state."""
    times_s = [frame["time_s"] for frame in flight.frames if frame["state"] == state]
    return round((times_s[0] + times_s[-1]) / 2, 1)


# Its frames


def test_a_frame_tells_the_last_minute_of_the_belief(flight: RecordedChase) -> None:
    frame = flight.at(PURSUED_S)
    track = frame["track"]
    assert len(track["time_s"]) == frame["movements"]
    assert np.diff(track["time_s"]) == pytest.approx(FLIGHT.decision_s, abs=0.21)
    assert track["time_s"][-1] <= frame["time_s"]
    assert frame["estimate"] is not None
    assert (track["target_m"][-1], track["radius_m"][-1]) == (
        frame["estimate"]["position_m"],
        frame["estimate"]["radius_m"],
    )
    assert track["share_within"][-1] == frame["share_within"]
    last = flight.frames[-1]
    assert last["share_within"] is not None
    assert last["share_within"] > 0.4 > track["share_within"][0] == 0.0  # type: ignore[operator]


def test_what_was_more_than_a_minute_ago_is_not_told() -> None:
    """The snapshot of a flight, dated again and again half a second later."""
    frames: list[Frame] = []
    shown = ShownChase(frames.append, scenario=FLIGHT, limits=site_limits(FLIGHT))
    while shown.chase.service.snapshot().movements == 0:
        shown.chase.tick()
    snapshot = shown.chase.service.snapshot()
    for number in range(1, 200):
        later_ns = snapshot.time_ns + number * SECOND_NS // 2
        shown._chronicle(dataclasses.replace(snapshot, time_ns=later_ns, movements=number + 1), None)
    last = frames[-1]
    assert len(last["path_m"]) == len(last["track"]["time_s"]) == 121
    assert last["track"]["time_s"][-1] - last["track"]["time_s"][0] == pytest.approx(TRACK_S)


def test_the_region_holds_the_points_of_the_belief(flight: RecordedChase) -> None:
    """95 of 100, to a point: its axes are at right angles, and its reach is counted."""
    frame = flight.at(PURSUED_S)
    assert frame["estimate"] is not None
    assert frame["estimate"]["region"] is not None
    axes_m = np.array(frame["estimate"]["region"]["half_axes_m"])
    lengths_m = np.linalg.norm(axes_m, axis=1)
    assert axes_m @ axes_m.T == pytest.approx(np.diag(lengths_m**2), abs=0.02 * lengths_m.max() ** 2)
    apart_m = np.array(frame["belief_m"]) - frame["estimate"]["region"]["center_m"]
    inside = ((apart_m @ axes_m.T / lengths_m**2) ** 2).sum(axis=1) <= 1
    assert inside.mean() == pytest.approx(0.95, abs=0.02)


def test_closing_speed_and_time_to_go_are_those_of_the_flight(flight: RecordedChase) -> None:
    """As the distance to the simulated target has shrunk in the second around."""
    before, frame, after = (flight.at(PURSUED_S + second) for second in (-0.5, 0.0, 0.5))

    def distance_m(one: Frame) -> float:
        assert one["center_m"] is not None
        assert one["target_m"] is not None
        return math.dist(one["center_m"], one["target_m"])

    closed_mps = distance_m(before) - distance_m(after)
    assert closed_mps > 5
    told = frame["interception"]
    assert told is not None
    assert told["closing_mps"] == pytest.approx(closed_mps, abs=2)
    assert told["time_to_go_s"] == pytest.approx(distance_m(frame) / closed_mps, abs=1)


# On the page


def test_the_page_shows_a_flight(page: Any, flight: RecordedChase) -> None:
    go_to(page, PURSUED_S)
    for place, words in {
        "#state-name": "PURSUING",  # as the style writes it
        "#pursuit-target": r"\d\.\d m/s towards \d{3}° [NESW]+",
        "#pursuit-closing": r"\d\.\d m/s",
        "#pursuit-to-go": r"\d\.\d s",
        "#pursuit-intercept": r"−?\d+, −?\d+, −?\d+ m",
        "#pursuit-within-what": "belief within 2 m",
        "#pursuit-within": "0 %",
        "#key-intercept": "predicted intercept",
    }.items():
        assert re.search(words, page.inner_text(place)), place
    assert re.search(
        r"north up: the target is believed \d+ m away, bearing \d{3}° [NESW]+, to be met in \d+ s",
        page.get_attribute("#map", "aria-label"),
    )
    assert re.search(
        r"now 95 % within \d+\.\d m, 0 % within the success radius", page.get_attribute("#belief-chart", "aria-label")
    )
    assert page.locator("#decision-panel").is_hidden()
    assert not re.search("NaN|undefined|null|Infinity", page.inner_text("body"))
    assert page.locator("#pursuit-followed-row").is_hidden()
    go_to(page, half_way_s(flight, "following"))
    assert page.inner_text("#state-name") == "FOLLOWING"
    assert page.inner_text("#pursuit-followed-what") == "followed within 10 m"
    assert re.fullmatch(r"100 % of [01] s", page.inner_text("#pursuit-followed"))
    go_to(page, half_way_s(flight, "reached"))
    until(lambda: page.locator("#result-title").text_content() == "Target reached")
    assert int(page.inner_text("#pursuit-within").split()[0]) > 40


@pytest.mark.parametrize("size", [PHONE, LARGE, SMALL])
def test_nothing_is_cut_or_covered(page: Any, size: tuple[int, int]) -> None:
    go_to(page, PURSUED_S)
    page.set_viewport_size({"width": size[0], "height": size[1]})
    until(lambda: page.evaluate("document.documentElement.scrollWidth") == size[0])
    boxes = [page.locator(part).bounding_box() for part in ("#scene", "#map", "#trackers", "#traces", "#pursuit-panel")]
    for index, one in enumerate(boxes):
        assert one["x"] >= 0
        assert one["x"] + one["width"] <= size[0]
        assert min(one["width"], one["height"]) > 60
        for other in boxes[index + 1 :]:
            beside = one["x"] + one["width"] <= other["x"] or other["x"] + other["width"] <= one["x"]
            above = one["y"] + one["height"] <= other["y"] or other["y"] + other["height"] <= one["y"]
            assert beside or above
    chart = page.locator("#belief-chart").bounding_box()
    assert chart["height"] > 50
    assert chart["y"] + chart["height"] <= boxes[-1]["y"] + boxes[-1]["height"]


def test_every_text_and_line_of_a_flight_stands_out(page: Any, flight: RecordedChase) -> None:
    """Also what is painted: on the map, beside the vehicles in space, and along the charts."""
    seen = set()
    for state in ("pursuing", "following", "reached"):
        # With every alarm of the flight: a receiver is silent.
        go_to(page, 2.5 if state == "pursuing" else half_way_s(flight, state))
        for scheme in reversed(SCHEMES):
            page.evaluate("window.painted = {}")
            page.emulate_media(color_scheme=scheme)
            until(lambda: places_painted(page) >= {"map", "traces", "belief-chart"})
            found = contrasts(page)
            assert [one for one in found if one[0] < LEAST_CONTRAST] == [], (state, scheme)
            assert len(found) > 100
            seen |= {text for _, text in found}
            lines = contrasts_of_colors(page, MAP_COLORS, "horizon")
            assert [one for one in lines.items() if one[1] < LEAST_CONTRAST_OF_LINES] == [], scheme
    missed = [words for words in SEEN if not any(re.fullmatch(words, text) for text in seen)]
    assert missed == []


def test_the_map_has_the_target_where_it_is_believed_to_be(page: Any, flight: RecordedChase) -> None:
    """The middle of what is painted in the belief's colour lies in its direction from the trackers."""
    frame = flight.at(2.0)
    assert frame["estimate"] is not None
    go_to(page, 2.0)
    page.wait_for_timeout(SETTLED_MS)
    colors = np.asarray(Image.open(io.BytesIO(page.locator("#map").screenshot())).convert("RGB"), dtype=np.int64)

    def middle(name: str) -> Any:
        color = page.evaluate(f"getComputedStyle(document.documentElement).getPropertyValue('--{name}').trim()")
        rows, columns = np.nonzero(is_near(colors, color))
        assert len(rows) > 10, name
        return np.array([columns.mean(), -rows.mean()])

    east, north = middle("belief") - (middle("tracker-0") + middle("tracker-1")) / 2
    off_deg = math.degrees(math.atan2(east, north)) - frame["estimate"]["bearing_deg"]
    assert abs((off_deg + 180) % 360 - 180) < 25


def is_near(colors: Any, color: str) -> Any:
    return (abs(colors - np.array(Image.new("RGB", (1, 1), color).getpixel((0, 0)))) < 12).all(axis=2)


def test_the_way_from_event_to_event(page: Any, flight: RecordedChase) -> None:
    times_s = sorted({event["time_s"] for event in flight.frames[-1]["events"]})
    go_to(page, 0.5)
    titles = [mark.get_attribute("title") for mark in page.locator("#marks i").all()]
    assert len(titles) >= 3
    assert any("pursuing -> following" in title for title in titles)
    seen = []
    while page.locator("#event-after").is_enabled():
        page.locator("#event-after").press("Enter")
        seen.append(float(page.locator("#slider").input_value()))
    assert seen == pytest.approx([time_s for time_s in times_s if time_s > 0.56], abs=0.051)
    until(lambda: page.locator("#result-title").text_content() == "Target reached")
    page.locator("#event-before").click()
    until(lambda: page.locator("#state-name").text_content() == "following")


# Drawn


def test_the_command_draws_it(flight: RecordedChase, tmp_path: Path) -> None:
    log = tmp_path / "flight.mcap"
    recorder = ChaseRecorder(log, flight.head)
    for entry in flight.entries:
        recorder.record(entry)
    for frame in flight.frames:
        recorder.record_frame(frame)
    recorder.close()
    ran = subprocess.run(
        [sys.executable, "-m", "swarmchase", "replay", str(log), "--report"], capture_output=True, text=True, check=True
    )
    report = log.with_suffix(".html")
    assert f"The report is {report}." in " ".join(ran.stderr.split())
    drawn = re.search(r'src="data:image/png;base64,([^"]+)"', report.read_text())
    assert drawn
    picture = np.asarray(Image.open(io.BytesIO(base64.b64decode(drawn[1]))).convert("RGB"), dtype=np.int64)
    assert picture.shape[1] == pytest.approx(7.16 * 200, abs=2)
    for name, color in {"pursuing": "#56B4E9", "reached": "#009E73", "belief": "#7B3294", "target": "#D55E00"}.items():
        assert is_near(picture, color).sum() > 50, name


def test_a_log_in_which_nothing_flies_is_not_drawn(flight: RecordedChase, tmp_path: Path) -> None:
    log = tmp_path / "nothing.mcap"
    ChaseRecorder(log, flight.head).close()
    with pytest.raises(InputError, match="there is nothing to draw"):
        ReplayCommand(file=log, report=True).run()
    assert not log.with_suffix(".html").exists()
