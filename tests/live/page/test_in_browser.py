"""The live system's page in a real browser: what it shows of chases that the real service has flown."""

import dataclasses
import io
import json
import re
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from PIL import Image

from page_contrast import LEAST_CONTRAST, SCHEMES, contrasts
from page_frames import (
    RecordedChase,
    misheard_chase,
    ordinary_chase,
    recorded,
    troubled_chase,
    wordless_chase,
)
from page_publisher import LiveChase
from page_serving import port_of, served, until
from swarmchase.live.link.messages import Severity as LinkSeverity
from swarmchase.live.page.feed import Feed
from swarmchase.live.page.server import PageServer
from swarmchase.live.service.chase_state import PreflightCheck, Snapshot, TrackerLine

CHROMIUM = shutil.which("chromium")
QUIET = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]
PHONE, SMALL, LARGE = (390, 844), (1280, 800), (1920, 1080)
LASTING_MS = 500
REPAINTED_MS = 300
PATIENCE_MS = 60_000
TROUBLED_S, ABORTED_S, REACHED_S = 14.0, 26.5, 26.5
"""In the troubled chase three trackers are lost, one is silent, and all hold; later it has been aborted. The ordinary
one has reached its target."""
WITHOUT_WEBGL = """
const before = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
  return kind.startsWith("webgl") ? null : before.call(this, kind, ...rest);
};
"""
HEARING = """
document.addEventListener("DOMContentLoaded", () => {
  window.heard = [];
  for (const place of document.querySelectorAll("#spoken-state, #spoken-alarm")) {
    const hears = () => window.heard.push(`${place.id}: ${place.textContent}`);
    new MutationObserver(hears).observe(place, { childList: true, characterData: true, subtree: true });
  }
});
"""
REDDENED = """
() => {
  const red = getComputedStyle(document.documentElement).getPropertyValue("--red").trim();
  const probe = document.createElement("i");
  probe.style.color = red;
  document.body.append(probe);
  const color = getComputedStyle(probe).color;
  probe.remove();
  return [...document.querySelectorAll("body *")]
    .filter((element) => element.checkVisibility() && element.textContent.trim() && !element.closest("svg"))
    .filter((element) => {
      const look = getComputedStyle(element);
      return [look.color, look.backgroundColor, look.borderTopColor].includes(color);
    })
    .map((element) => element.textContent.trim());
}
"""


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    if CHROMIUM is None:
        pytest.skip("there is no chromium (Debian: apt-get install chromium)")
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed: pip install -e '.[dev]'"
    )
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=QUIET)
        yield browser
        browser.close()


class Window:
    """A browser's window, and what went wrong in it."""

    def __init__(
        self, browser: Any, url: str, size: tuple[int, int] = SMALL, script: str = "", scheme: str = "dark"
    ) -> None:
        self.context = browser.new_context(viewport={"width": size[0], "height": size[1]}, color_scheme=scheme)
        self.page = self.context.new_page()
        self.errors: list[str] = []
        self.requests: list[str] = []
        self.said: list[str] = []
        self.page.on("console", lambda one: self.errors.append(one.text) if one.type == "error" else None)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("websocket", self._listen)
        if script:
            self.page.add_init_script(script)
        self.page.goto(url)

    def _listen(self, socket: Any) -> None:
        self.requests.append(socket.url)
        socket.on("framesent", lambda sent: self.said.append(json.loads(sent).get("word", "")))

    def shows(self, selector: str, text: str | re.Pattern[str] = "", **attributes: str | re.Pattern[str]) -> None:
        """It is there, or comes soon."""
        from playwright.sync_api import expect

        place = self.page.locator(selector)
        expect(place).to_be_visible(timeout=PATIENCE_MS)
        if text:
            expect(place).to_contain_text(text, timeout=PATIENCE_MS)
        for name, value in attributes.items():
            expect(place).to_have_attribute(name.replace("_", "-"), value, timeout=PATIENCE_MS)

    def says(self, place: str, text: str) -> None:
        """A screen reader has heard it, however short it was there, or hears it soon. The page needs ``HEARING``."""
        pattern = re.compile(f"{place}: .*{text}")
        self.waits(lambda: any(map(pattern.match, self.page.evaluate("window.heard"))))

    def waits(self, condition: Callable[[], Any]) -> None:
        """While the page goes on."""
        until(lambda: condition() or self.page.wait_for_timeout(20), PATIENCE_MS / 1000)

    def hides(self, *selectors: str) -> None:
        from playwright.sync_api import expect

        for selector in selectors:
            expect(self.page.locator(selector)).to_be_hidden(timeout=PATIENCE_MS)

    def press_for(self, selector: str, milliseconds: float) -> None:
        """A pointer goes down on it and up again."""
        box = self.box(selector)
        self.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        self.page.mouse.down()
        self.page.wait_for_timeout(milliseconds)
        self.page.mouse.up()

    def goes_to(self, time_s: float) -> None:
        """It shows the frame next to this moment: there are ten a second."""
        self.page.locator("#slider").fill(f"{time_s:g}")
        until(lambda: abs(float(self.data("timeS")) - time_s) < 0.11)

    def text(self, selector: str) -> str:
        return str(self.page.locator(selector).inner_text())

    def data(self, name: str) -> str:
        return str(self.page.evaluate(f"document.body.dataset.{name}"))

    def box(self, selector: str) -> dict[str, float]:
        found: dict[str, float] = self.page.locator(selector).bounding_box()
        return found


@contextmanager
def opened(browser: Any, server: PageServer, **options: Any) -> Iterator[Window]:
    """A window in which nothing may go wrong, and from which no request may leave."""
    window = Window(browser, server.url, **options)
    try:
        yield window
        assert window.errors == []
        own = re.compile(rf"(http|ws)://127\.0\.0\.1:{port_of(server)}/")
        assert [url for url in window.requests if not own.match(url)] == []
    finally:
        window.context.close()


@contextmanager
def live_chase(**options: Any) -> Iterator[tuple[PageServer, LiveChase]]:
    with LiveChase(**options) as chase, served(chase.feed) as server:
        yield server, chase


def fed(chase: RecordedChase, until_s: float = float("inf")) -> Feed:
    """A recording of it up to this moment."""
    feed = Feed(chase.info, is_live=False)
    for frame in chase.frames:
        if frame["time_s"] <= until_s:
            feed.publish(frame)
    return feed


@contextmanager
def looked_back(browser: Any, chase: RecordedChase, at_s: float, **options: Any) -> Iterator[Window]:
    """A window with a recording that stands still at this moment."""
    with served(fed(chase)) as server, opened(browser, server, **options) as window:
        window.shows("#play", "Pause")
        window.page.locator("#play").click()
        window.goes_to(at_s)
        yield window


def assert_it_changes(window: Window, selector: str) -> None:
    before = window.text(selector)
    until(lambda: window.text(selector) != before)


# What it shows


@pytest.mark.parametrize("sizes", [{PHONE: "dark"}, {SMALL: "light", LARGE: "dark"}])
def test_page_shows_a_chase_in_trouble(chromium: Any, sizes: dict[tuple[int, int], str]) -> None:
    """In windows of these sizes and colours: the second is the first one that has grown."""
    size, scheme = next(iter(sizes.items()))
    with looked_back(chromium, troubled_chase(), TROUBLED_S, size=size, scheme=scheme) as window:
        window.shows("#state-name", "holding")
        window.shows("#reason", "2 trackers are too few")
        window.shows("#title", "chase 0 of seed 3, 2033-05-18 00:00:00 UTC")
        for number, status in enumerate(["ok", "ok", "silent", "lost", "lost", "lost"]):
            window.shows(f'tr[data-tracker="{number}"] [data-column="status"]', status)
        window.shows('[data-trace="2"]', re.compile(r"2 silent \d+\.\d s"))
        alarms = window.page.locator("#alarms li").all_inner_texts()
        for words in (
            "all hold: 2 trackers",
            "tracker 3 is lost",
            "tracker 2 is silent",
            "safety filter changed movement",
        ):
            assert any(words in alarm for alarm in alarms), words
        assert any(re.search(r"datagrams are rejected: .*wrong key \d+(\.\d)?/s", alarm) for alarm in alarms)
        assert "✖" in alarms[0]
        window.shows("#rejected", re.compile(r"rejected since the start \d+: .*wrong key \d+"))
        events = window.page.locator("#events li").all_inner_texts()
        assert re.search(r"0:13\.0 tracker 5 is lost", events[0])
        assert "idle -> connecting: the operator starts" in events[-1]
        window.shows("#estimate", re.compile(r"\d+\.\d m ± \d+\.\d m, bearing \d{3}° [NESW]+, \d+° (up|down)|level"))
        window.shows("#distance-figure", "to target, simulated")
        window.shows("#latency", re.compile(r"\d ms"))
        window.shows("#decision-note", re.compile("Flown otherwise: centre moved by .* m to keep the"))
        assert window.page.locator('.bar[data-chosen="true"]').count() == 4
        for (width, height), scheme in sizes.items():
            window.page.set_viewport_size({"width": width, "height": height})
            window.page.emulate_media(color_scheme=scheme)
            window.page.wait_for_timeout(REPAINTED_MS)
            assert_it_is_laid_out(window, (width, height))
            assert_it_is_drawn(window, scheme)


def assert_it_is_laid_out(window: Window, size: tuple[int, int]) -> None:
    """Everything is as wide as the window at most, all of it inside where the window is large, and nothing lies over
    anything else.
    """
    width, height = window.page.evaluate(
        "[document.documentElement.scrollWidth, document.documentElement.scrollHeight]"
    )
    assert width == size[0]
    parts = ["#brand", "#state", "#figures", "#alarms-panel", "#scene-panel", "#trackers-panel", "#traces-panel"]
    boxes = [window.box(part) for part in [*parts, "#decision-panel", "#events-panel"]]
    if size != PHONE:
        assert height == size[1]
        boxes.append(window.box("#timeline"))
    for index, one in enumerate(boxes):
        assert one["x"] >= 0
        assert one["x"] + one["width"] <= size[0]
        assert one["y"] + one["height"] <= height
        for other in boxes[index + 1 :]:
            beside = one["x"] + one["width"] <= other["x"] or other["x"] + other["width"] <= one["x"]
            above = one["y"] + one["height"] <= other["y"] or other["y"] + other["height"] <= one["y"]
            assert beside or above
    for table, panel in [("#trackers", "#trackers-panel"), ("#decision", "#decision-panel")]:
        inner, outer = window.box(table), window.box(panel)
        assert inner["x"] + inner["width"] <= outer["x"] + outer["width"]
        assert inner["y"] + inner["height"] <= outer["y"] + outer["height"]
    cut = window.page.evaluate(
        "[...document.querySelectorAll('.bar, .bar span:not(.fill, .unseen), button, #trackers td')]"
        ".filter((one) => one.checkVisibility() && one.scrollWidth > one.clientWidth + 1 && one.clientWidth > 0)"
        ".map((one) => one.textContent)"
    )
    assert cut == []


def assert_it_is_drawn(window: Window, scheme: str) -> None:
    """The picture and the traces have the colours of the trackers that are heard in them."""
    assert window.page.locator("#scene-missing").is_hidden()
    for part, least_pixels in [("#scene", 20), ("#traces", 40)]:
        picture = Image.open(io.BytesIO(window.page.locator(part).screenshot())).convert("RGB")
        hues, saturations, _ = np.moveaxis(np.asarray(picture.convert("HSV"), dtype=np.int64), 2, 0)
        for number in (0, 1):
            color = window.page.evaluate(
                f"getComputedStyle(document.documentElement).getPropertyValue('--tracker-{number}').trim()"
            )
            hue = Image.new("RGB", (1, 1), color).convert("HSV").getpixel((0, 0))
            assert isinstance(hue, tuple)
            close = (abs(hues - hue[0]) <= 6) & (saturations > 90)
            assert close.sum() >= least_pixels, f"{part}: tracker {number} in {scheme}"


def test_a_normal_start_shows_nothing_red(chromium: Any) -> None:
    """From before the first frame, over trackers that have not come yet, to the first movements."""
    with served(Feed(ordinary_chase().info, is_live=True)) as server, opened(chromium, server) as window:
        window.shows("#reason", "waiting for the first frame")
        window.hides("#banner")
        assert window.page.evaluate(REDDENED) == []
    chase = LiveChase(starts=False)
    let_come = keep_away(chase, range(6))
    with chase, served(chase.feed) as server, opened(chromium, server) as window:
        window.shows("#state-name", "idle")
        window.shows('tr[data-tracker="5"] [data-column="status"]', "waiting")
        window.page.locator("#start:enabled").click()
        window.shows("#start", "Confirm start")
        assert window.page.evaluate(REDDENED) == []
        window.page.wait_for_timeout(TOO_SOON_MS)
        window.page.locator("#start").click()
        window.shows("#state-name", "connecting")
        assert window.page.evaluate(REDDENED) == []
        let_come()
        window.shows("#movements", re.compile("[1-9]"))
        window.shows('tr[data-tracker="5"] [data-column="status"]', "ok")
        window.shows("#alarms", "no alarms")
        assert window.page.evaluate(REDDENED) == []
    reds = [alarm for frame in ordinary_chase().frames for alarm in frame["alarms"]]
    assert reds == []


def keep_away(chase: LiveChase, trackers: Iterable[int]) -> Callable[[], None]:
    """From now on nothing of these trackers reaches the service, until what this gives is called."""
    away = {("tracker", tracker) for tracker in trackers}
    controller = chase.shown.chase.network.controller
    put = controller.put
    controller.put = lambda datagram, address: None if address in away else put(datagram, address)  # type: ignore[method-assign]
    return away.clear


TOO_SOON_MS = 450


def test_every_text_has_a_contrast_of_four_and_a_half(chromium: Any) -> None:
    def least(window: Window) -> None:
        for scheme in SCHEMES:
            window.page.emulate_media(color_scheme=scheme)
            found = contrasts(window.page)
            assert len(found) > 100
            assert [one for one in found if one[0] < LEAST_CONTRAST] == []

    with looked_back(chromium, troubled_chase(), TROUBLED_S) as window:
        least(window)
        window.goes_to(ABORTED_S)
        least(window)
    with looked_back(chromium, ordinary_chase(), REACHED_S) as window:
        least(window)
    with LiveChase(starts=False) as chase, served(chase.feed) as server, opened(chromium, server) as window:
        chase.shown.amend = with_every_word
        window.shows("#preflight", "tracker 2, clock")
        least(window)
        chase.shown.say("start")
        window.shows("#movements", re.compile("[1-9]"))
        window.page.locator("#reached").click()
        window.shows("#reached", data_armed="true")
        least(window)
        window.page.locator("#slider").press("Home")
        window.shows("body", data_past="true")
        least(window)
        chase.stop()
        window.shows("body", data_stale="true")
        window.shows("#banner", "No data for")
        least(window)


def with_every_word(snapshot: Snapshot) -> Snapshot:
    """A snapshot with what only autopilots, receivers and the judgement of trackers put there."""
    one, *others = snapshot.trackers
    one = dataclasses.replace(
        one,
        left_out="12 m from its place",
        notices=(TrackerLine(1, LinkSeverity.WARNING, "EKF variance"),),
        dropped={"no signal": 7},
    )
    checks = (
        PreflightCheck("armed", True, "", None),
        PreflightCheck("clock", False, "3 s behind", 2),
        PreflightCheck("mode", None, "", 3),
    )
    return dataclasses.replace(snapshot, trackers=(one, *others), preflight=checks)


def test_the_checklist_is_overridden_in_words(chromium: Any) -> None:
    with LiveChase(starts=False) as chase, served(chase.feed) as server, opened(chromium, server) as window:
        chase.shown.amend = with_every_word
        window.shows("#preflight-count", "1 of 3 passed")
        assert window.page.locator("#preflight li").all_text_contents() == [
            "✓passed: armed: passed",
            "⚠failed: tracker 2, clock: 3 s behind",
            "·not known yet: tracker 3, mode: not known yet",
        ]
        window.shows('tr[data-tracker="0"] [data-column="status"]', "left out")
        detail = window.page.locator('tr[data-tracker="0"] + tr.detail')
        assert detail.inner_text() == (
            "left out: 12 m from its place; samples dropped: 7 no signal; says (warning): EKF variance"
        )
        window.shows("#alarms", "tracker 0 is left out: 12 m from its place")
        window.shows("#events", "tracker 0: EKF variance")
        for typed in ("", "yes", "over ride"):
            window.page.locator("#override-word").fill(typed)
            assert window.page.locator("#override").is_disabled()
        window.page.locator("#override-word").fill("override")
        window.page.locator("#override-word").press("Enter")
        until(lambda: window.page.wait_for_timeout(10) or "override" in window.said)
        chase.shown.say("start")
        window.hides("#preflight-panel")


def test_who_hears_the_page_is_told(chromium: Any) -> None:
    with live_chase(ahead_s=1.0) as (server, chase), opened(chromium, server, script=HEARING) as window:
        window.says("spoken-state", "under way")
        keep_away(chase, {3, 4, 5})
        window.says("spoken-alarm", "tracker 5 is lost")
        window.says("spoken-state", "holding")
        roles = "(one) => [one.getAttribute('role'), one.getAttribute('aria-live')]"
        assert window.page.locator("#spoken-alarm").evaluate(roles) == ["alert", "assertive"]
        assert window.page.locator("#spoken-state").evaluate(roles) == ["status", "polite"]
        tree = window.page.locator("body").aria_snapshot()
        for name in ('button "Abort A"', 'button "Target reached"', 'heading "Alarms"', 'table "Trackers"'):
            assert name in tree, tree
        assert "critical: tracker 3 is lost" in tree
        assert window.page.locator("#abort").get_attribute("aria-describedby") == "abort-note"
        window.shows("#abort-note", "all hold where they are")
        nameless = window.page.evaluate(
            "[...document.querySelectorAll('button, input, select')].filter((one) => one.checkVisibility()"
            " && !one.innerText.trim() && !one.getAttribute('aria-label') && !one.labels?.length).length"
        )
        assert nameless == 0


def test_traces_are_told_apart_without_colour(chromium: Any) -> None:
    with looked_back(chromium, ordinary_chase(), 20.0) as window:
        dashes = window.page.evaluate(
            "[...document.querySelectorAll('#traces-key line')].map((one) => one.getAttribute('stroke-dasharray'))"
        )
        assert len(set(dashes)) == len(dashes) == 6
        grey = window.page.evaluate(
            "() => { document.querySelector('#traces').style.filter = 'grayscale(1)'; return 1; }"
        )
        assert grey
        window.page.wait_for_timeout(50)
        picture = np.asarray(Image.open(io.BytesIO(window.page.locator("#traces").screenshot())).convert("L"), np.int64)
        labels = picture[:, -20:]
        rows = (np.abs(labels - np.median(labels)) > 60).any(axis=1)
        assert np.count_nonzero(np.diff(rows.astype(int)) == 1) >= 3  # numbers at the ends


@pytest.mark.parametrize("controller", ["gradient", "paper"])
def test_who_has_no_belief_says_so(chromium: Any, controller: str) -> None:
    chase = wordless_chase(controller)
    with looked_back(chromium, chase, 0.3) as window:
        window.shows("#estimate", "no decision yet")
        window.goes_to(11.0)
        window.shows("#estimate", "this controller does not say where it thinks the target is")
        window.hides("#key-belief", "#key-target", "#distance-figure")
        assert not re.search("NaN|undefined|null|Infinity", window.text("body"))


def test_what_adaptive_finds_out_of_the_radio_is_told(chromium: Any) -> None:
    chase = misheard_chase()
    with looked_back(chromium, chase, 0.3) as window:
        window.hides("#channel-figure")
        window.goes_to(3.0)
        window.shows("#channel", re.compile(r"power [+−]?\d+\.\d dB · exponent \d\.\d · fading \d\.\d dB"))
        window.shows("#channel", re.compile(r"(east|west|north|south|up|down) wrong"))
        assert not re.search("NaN|undefined|null|Infinity", window.text("body"))


def test_an_estimate_needs_no_simulation(chromium: Any) -> None:
    chase = recorded(8.0, with_target=False, controller="multilateration")
    with looked_back(chromium, chase, 7.5) as window:
        window.shows("#estimate", re.compile(r"\d m \(it does not say how sure it is\), bearing \d{3}°"))
        window.hides("#distance-figure")


def test_the_longest_bar_is_what_is_taken_or_the_page_says_why(chromium: Any) -> None:
    """A belief's bars say what the decision goes by; a policy's are chances, and chance takes others, too."""
    for chase in (ordinary_chase(), troubled_chase()):
        for gap in gaps(chase):
            assert gap <= 1e-3
    chase = wordless_chase("paper", "sampled")
    drawn = next(
        frame["time_s"] for frame, gap in zip(chase.frames, map(most_against, chase.frames), strict=True) if gap > 1e-3
    )
    with looked_back(chromium, chase, drawn) as window:
        window.shows("#decision-note", "Bars: how probable each choice is.")
        window.shows("#decision-note", re.compile("Not the longest bar at .*: choices are drawn by chance"))


def gaps(chase: RecordedChase) -> list[float]:
    found = [most_against(frame) for frame in chase.frames if frame["decision"] is not None]
    assert len(found) > 100
    return found


def most_against(frame: Any) -> float:
    """By how much a choice that was not taken has the longer bar."""
    decision = frame["decision"]
    if decision is None or decision["choice_share"] is None:
        return 0.0
    info = ordinary_chase().info
    choices = [info["spacing_choices_m"], *3 * [info["displacement_choices_m"]]]
    taken = [decision["spacing_m"], *decision["displacement_m"]]
    return max(
        max(shares) - shares[choices_m.index(taken_m)]
        for choices_m, taken_m, shares in zip(choices, taken, decision["choice_share"], strict=True)
    )


def test_the_result_stays(chromium: Any) -> None:
    """Also when the service has ended; and success does not look like a failure."""
    chase = ordinary_chase()
    feed = Feed(chase.info, is_live=True)
    server = PageServer(feed, "127.0.0.1", 0)
    window = Window(chromium, server.url)
    try:
        for frame in chase.frames:
            if frame["time_s"] < REACHED_S:
                feed.publish(frame)
        window.shows("#result", data_state="reached")
        window.shows("#result-title", "Target reached")
        window.shows("#result-figures", re.compile(r"7 movements in 0:24\.2; the simulated target is \d\.\d m from"))
        assert window.page.evaluate(REDDENED) == []
        server.close()
        window.shows("#banner", "The chase has ended", data_severity="info")
        window.shows("#result-title", "Target reached")
        window.shows("body", data_stale="false")
        # Each figure shows how old it is when it is drawn next.
        window.page.wait_for_function(f"() => ({REDDENED})().length === 0")
    finally:
        window.context.close()
        server.close()


def test_an_abort_says_what_it_is(chromium: Any) -> None:
    with looked_back(chromium, troubled_chase(), ABORTED_S) as window:
        window.shows("#result-title", "Aborted")
        window.shows("#result-reason", "the operator aborts")
        window.goes_to(20.0)
        window.hides("#result")


def test_old_data_are_greyed(chromium: Any) -> None:
    with LiveChase() as chase, served(chase.feed) as server, opened(chromium, server) as window:
        window.shows("body", data_stale="false", data_connection="live")
        window.hides("#banner")
        chase.stop()
        window.shows("body", data_stale="true", data_connection="stale")
        window.shows("#banner", re.compile(r"No data for \d+\.\d s: the service sends nothing"))
        window.shows('tr[data-tracker="0"]', data_stale="stale")
        window.shows('[data-trace="0"]', "stale")
        assert_it_changes(window, 'tr[data-tracker="0"] [data-column="rssi-age"]')
        window.page.reload()  # what was old stays old
        window.shows("#banner", "No data for")


# What it says


def test_start_is_confirmed_then_hold_and_resume(chromium: Any) -> None:
    with live_chase(starts=False, ahead_s=1.0) as (server, chase), opened(chromium, server) as window:
        window.page.locator("#start:enabled").dblclick()
        window.shows("#start", "Confirm start", data_armed="true", aria_pressed="true")
        assert chase.heard == []
        window.page.wait_for_timeout(TOO_SOON_MS)
        window.page.locator("#start").click()
        window.shows("#state-name", re.compile("sampling|moving"))
        for label, word, state in [("Hold", "hold", "holding"), ("Resume", "resume", re.compile("sampling|moving"))]:
            window.shows("#hold", label, data_word=word)
            window.page.wait_for_timeout(TOO_SOON_MS)  # a button that has just changed its meaning takes no click
            window.page.locator("#hold").click()
            window.shows("#state-name", state)
        window.shows("#said", "sent: resume")
        window.page.keyboard.press("h")
        window.shows("#state-name", "holding")
        window.page.keyboard.press("h")  # the key never resumes
        window.page.keyboard.press("Control+h")
        window.page.wait_for_timeout(300)
        assert chase.heard == ["start", "hold", "resume", "hold", "hold"]
        window.shows("#state-name", "holding")


def test_a_double_click_does_not_hold_and_resume(chromium: Any) -> None:
    with live_chase(ahead_s=1.0) as (server, chase), opened(chromium, server) as window:
        window.shows("#hold", "Hold")
        window.page.wait_for_timeout(TOO_SOON_MS)
        window.page.locator("#hold").dblclick()
        window.shows("#state-name", "holding")
        window.page.wait_for_timeout(300)
        assert set(chase.heard) == {"hold"}


def by_pointer(window: Window, milliseconds: float) -> None:
    window.press_for("#abort", milliseconds)


def by_key(window: Window, milliseconds: float) -> None:
    window.page.keyboard.down("a")
    window.page.wait_for_timeout(milliseconds)
    window.page.keyboard.up("a")


def by_space_bar(window: Window, milliseconds: float) -> None:
    window.page.locator("#abort").focus()
    window.page.keyboard.down(" ")
    window.page.wait_for_timeout(milliseconds)
    window.page.keyboard.up(" ")


@pytest.mark.parametrize("press", [by_pointer, by_key, by_space_bar])
def test_abort_takes_one_press_that_lasts(chromium: Any, press: Callable[[Window, float], None]) -> None:
    with live_chase(ahead_s=1.0) as (server, chase), opened(chromium, server) as window:
        window.shows("#abort:enabled", data_pressed="false")
        press(window, 0.2 * LASTING_MS)
        window.shows("#said", "keep pressing to abort")
        window.page.wait_for_timeout(LASTING_MS)
        assert chase.heard == []
        press(window, 1.3 * LASTING_MS)
        window.shows("#state-name", "aborted")
        window.shows("#result-title", "Aborted")
        assert chase.heard == ["abort"]
        assert window.page.locator("#abort").is_disabled()


def test_a_screen_reader_can_abort(chromium: Any) -> None:
    """It clicks without a pointer, and cannot press for a while."""
    with live_chase(ahead_s=1.0) as (server, chase), opened(chromium, server) as window:
        window.shows("#abort:enabled")
        window.page.locator("#abort").evaluate("(button) => button.click()")
        window.shows("#state-name", "aborted")
        assert chase.heard == ["abort"]


def test_reached_needs_two_clicks(chromium: Any) -> None:
    with live_chase(ahead_s=1.0) as (server, chase), opened(chromium, server) as window:
        window.page.locator("#reached:enabled").click()
        window.shows("#reached", "Confirm reached", data_armed="true")
        window.shows("#reached", "Target reached", data_armed="false")  # what is not confirmed is forgotten
        window.page.locator("#reached").dblclick()
        window.shows("#reached", "Confirm reached")
        assert chase.heard == []
        window.page.wait_for_timeout(TOO_SOON_MS)
        window.page.locator("#reached").press("Enter")
        window.shows("#state-name", "reached")
        assert chase.heard == ["reached"]


def test_on_a_telephone_the_buttons_stay_in_sight(chromium: Any) -> None:
    with live_chase(ahead_s=1.0) as (server, chase), opened(chromium, server, size=PHONE) as window:
        window.shows("#hold", "Hold")
        window.page.evaluate("window.scrollTo(0, 900)")
        until(lambda: window.page.evaluate("window.scrollY") > 500)
        for button in ("#hold", "#abort"):
            box = window.box(button)
            assert box["y"] >= 0
            assert box["y"] + box["height"] < PHONE[1]
            assert box["height"] >= 44
        window.page.wait_for_timeout(TOO_SOON_MS)
        window.page.locator("#hold").click()
        window.shows("#state-name", "holding")
        assert chase.heard == ["hold"]


# Other moments


def test_looking_back_everything_is_of_one_moment_but_the_buttons(chromium: Any) -> None:
    with live_chase(ahead_s=12.0) as (server, chase), opened(chromium, server) as window:
        window.shows("#live", aria_pressed="true")
        window.page.locator("#slider").press("Home")
        window.shows("body", data_past="true", data_time_s=re.compile(r"^0(\.05)?$"))
        window.shows("#shown-time", "PAST")
        window.shows("#decision-number", "none yet")
        window.shows("#chase-time", re.compile(r"0:00\.[01]"))
        window.shows("#state-name", re.compile("connecting|sampling"))
        window.shows("#movements", "0")
        window.shows("#now", re.compile("now: (moving|sampling)"))
        chase.shown.say("hold")
        window.shows("#now", "now: holding")
        window.shows("#hold", "Resume")
        assert window.text("#chase-time") in {"0:00.0", "0:00.1"}
        window.goes_to(10.0)
        window.shows("#chase-time", re.compile(r"0:(09\.9|10\.\d)"))
        window.shows("#movements", "3")
        window.page.locator("#live").click()
        window.shows("body", data_past="false")
        window.shows("#state-name", "holding")
        window.hides("#now")


def test_replay(chromium: Any) -> None:
    chase = ordinary_chase()
    feed = fed(chase)
    with served(feed) as server, opened(chromium, server) as window:
        window.shows("body", data_connection="replay", data_stale="false")
        window.hides("#operator", "#live", "#banner")
        window.shows("#play", "Pause")
        until(lambda: 0.3 < float(window.data("timeS")) < 10)
        window.page.locator("#play").click()
        window.shows("#play", "Play")
        window.goes_to(15.0)
        window.shows("#shown-time", re.compile(r"0:1[45]\.\d of 0:27\.0"))
        window.shows("#chase-time", re.compile(r"0:1[45]\.\d"))
        window.page.locator("#rate").select_option("16")
        window.page.locator("#play").click()
        window.shows("#result-title", "Target reached")
        window.shows("#play", "Play")
        assert feed.words() == []


def test_page_goes_on_when_the_service_comes_back(chromium: Any) -> None:
    first = LiveChase(ahead_s=2.0)
    second = LiveChase(controller="gradient")
    second.shown.chase.restart_service(2)
    second.shown.say("start")
    server = PageServer(first.feed, "127.0.0.1", 0)
    window = Window(chromium, server.url)
    try:
        with first:
            window.shows("body", data_epoch="1", data_connection="live")
            window.page.locator("#slider").press("Home")
            window.shows("body", data_past="true")
            server.close()
        window.shows("body", data_connection="none", data_stale="true")
        window.shows("#banner", "not connected")
        assert window.page.locator("#hold").is_disabled()
        with second:
            server = PageServer(second.feed, "127.0.0.1", port_of(server))
            window.shows("body", data_epoch="2", data_connection="live", data_stale="false", data_past="false")
            window.page.locator("#hold:enabled").click()
            until(lambda: second.heard == ["hold"])
        assert [error for error in window.errors if "WebSocket connection" not in error] == []
    finally:
        window.context.close()
        server.close()


def test_without_webgl_the_rest_is_there(chromium: Any) -> None:
    with live_chase() as (server, _):
        window = Window(chromium, server.url, script=WITHOUT_WEBGL)
        window.shows("#scene-missing", "no WebGL")
        window.shows("body", data_connection="live")
        assert_it_changes(window, "#chase-time")
        window.context.close()


def test_a_change_of_scheme_repaints_the_page(chromium: Any) -> None:
    with looked_back(chromium, ordinary_chase(), 15.0, scheme="dark") as window:
        assert_it_is_drawn(window, "dark")
        window.page.emulate_media(color_scheme="light")
        window.page.wait_for_timeout(REPAINTED_MS)
        assert_it_is_drawn(window, "light")
        picture = Image.open(io.BytesIO(window.page.locator("#scene-place").screenshot())).convert("L")
        assert np.median(np.asarray(picture)) > 180


def test_the_token_leaves_the_address_bar_and_the_page_goes_on(chromium: Any) -> None:
    with LiveChase(ahead_s=4.0) as chase, served(chase.feed, "the token") as server:
        assert "?token=the%20token" in server.url
        with opened(chromium, server) as window:
            window.shows("body", data_connection="live")
            assert window.page.url == f"http://127.0.0.1:{port_of(server)}/"
            assert "token" not in window.page.evaluate("document.documentElement.outerHTML + history.state")
            window.page.reload()  # its cookie opens it now
            window.shows("body", data_connection="live")
            window.page.wait_for_timeout(LASTING_MS)
            window.page.locator("#hold").click()
            until(lambda: chase.heard == ["hold"])
