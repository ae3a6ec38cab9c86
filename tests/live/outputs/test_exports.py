"""What a recorded chase is exported to, drawn in and reported as: from the log of a real one, by the real command."""

import base64
import csv
import io
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from live.outputs.shown_chase import ORIGIN, Shown
from swarmchase.cli import main
from swarmchase.live.log.file import FRAMES_A_SCENE
from swarmchase.live.log.mcap_messages import messages
from swarmchase.live.log.scene import FRAME_ID, SCENE_SCHEMA, SceneEntity

OLD_LOG = Path(__file__).parents[1] / "log" / "logs" / "layout-4.mcap"
"""It says no origin."""
LAYOUT = Path(__file__).parents[3] / "deploy" / "foxglove-layout.json"


def replayed(*words: str, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Exit code and standard error."""
    code: Any = 0
    try:
        main(["replay", *words])
    except SystemExit as end:
        code = end.code
    output = capsys.readouterr()
    assert output.out == ""
    return code or 0, output.err


# GeoJSON and CSV


def test_geojson_has_the_ways_on_the_earth(shown: Shown, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "new" / "chase.geojson"
    code, told = replayed(str(shown.log.path), "--export", str(path), capsys=capsys)
    assert (code, told.splitlines()[-1]) == (0, f"The export is {path}.")
    document = json.loads(path.read_text())
    assert document["type"] == "FeatureCollection"
    features = {one["properties"]["name"]: one for one in document["features"]}
    names = [*(f"tracker {number}" for number in range(6)), "swarm", "estimate", "target"]
    assert list(features) == [*names, "target, 95 % of the belief at the end"]
    for name in names:
        geometry, times = features[name]["geometry"], features[name]["properties"]["times"]
        assert geometry["type"] == "LineString"
        assert len(geometry["coordinates"]) == len(times) > 5
        for (longitude_deg, latitude_deg, height_m), time_s in list(zip(geometry["coordinates"], times, strict=True))[
            ::7
        ]:
            since_s = time_s - shown.head.started_at.timestamp()
            frame = min(shown.frames, key=lambda frame: abs(frame["time_s"] - since_s))
            known = {f"tracker {number}": one["position_m"] for number, one in enumerate(frame["trackers"])}
            known |= {"swarm": frame["center_m"], "target": frame["target_m"]}
            known["estimate"] = frame["estimate"] and frame["estimate"]["position_m"]
            assert ORIGIN.metres((latitude_deg, longitude_deg, height_m)) == pytest.approx(known[name], abs=0.02)
    (ring,) = features["target, 95 % of the belief at the end"]["geometry"]["coordinates"]
    assert ring[0] == ring[-1]
    east, north = np.array(ring)[:, :2].T
    assert (east[:-1] * north[1:] - east[1:] * north[:-1]).sum() > 0  # counter-clockwise, as RFC 7946 has it


def test_csv_has_a_row_a_frame(shown: Shown, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "chase.csv"
    words = [str(shown.log.path), "--export", str(path), "--geoid-height-m", "47.5"]
    assert replayed(*words, capsys=capsys)[0] == 0
    rows = list(csv.DictReader(io.StringIO(path.read_text())))
    assert [float(row["time_s"]) for row in rows] == [frame["time_s"] for frame in shown.frames]
    for row, frame in zip(rows, shown.frames, strict=True):
        assert row["state"] == frame["state"]
        for name, place_m in (
            ("tracker_3", frame["trackers"][3]["position_m"]),
            ("target", frame["target_m"]),
            ("estimate", frame["estimate"] and frame["estimate"]["position_m"]),
        ):
            cells = [row[f"{name}_{axis}_m"] for axis in "xyz"]
            assert cells == ["", "", ""] if place_m is None else [float(cell) for cell in cells] == place_m
            if place_m is not None:
                keys = ("latitude_deg", "longitude_deg", "altitude_geodetic_m")
                latitude_deg, longitude_deg, height_m = (float(row[f"{name}_{key}"]) for key in keys)
                position = latitude_deg, longitude_deg, height_m - 47.5
                assert ORIGIN.metres(position) == pytest.approx(place_m, abs=0.02)
    assert rows[-1]["tracker_2_condition"] == "there"
    assert float(rows[-1]["tracker_2_rssi_dbm"]) < 0


def test_without_an_origin_there_are_metres_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, told = replayed(str(OLD_LOG), "--export", str(tmp_path / "chase.geojson"), capsys=capsys)
    assert (code, told.splitlines()[-1]) == (
        2,
        f"swarmchase: --export {tmp_path / 'chase.geojson'} is refused: it shows places on the earth; give "
        "--global-origin LATITUDE LONGITUDE ALTITUDE",
    )
    assert replayed(str(OLD_LOG), "--export", str(tmp_path / "chase.csv"), capsys=capsys)[0] == 0
    head = (tmp_path / "chase.csv").read_text().splitlines()[0]
    assert "swarm_x_m" in head
    assert "latitude" not in head
    words = [str(OLD_LOG), "--export", str(tmp_path / "chase.geojson"), "--global-origin", "-33.9", "18.4", "12"]
    assert replayed(*words, capsys=capsys)[0] == 0
    first = json.loads((tmp_path / "chase.geojson").read_text())["features"][0]["geometry"]["coordinates"][0]
    assert first[:2] == pytest.approx([18.4, -33.9], abs=0.001)


@pytest.mark.parametrize("words", [["--export", "chase.geojson"], ["--export", "chase.csv"], ["--report"]])
def test_what_is_there_is_replaced_only_when_somebody_says_so(
    words: list[str], shown: Shown, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("chase.mcap").write_bytes(shown.log.path.read_bytes())
    path = Path("chase.html" if words == ["--report"] else words[1])
    path.write_text("precious")
    code, told = replayed("chase.mcap", *words, capsys=capsys)
    refusal = f"cannot write {path}: it exists already; give --overwrite to replace it, or another name"
    assert (code, told) == (2, f"swarmchase: {refusal}\n")
    assert path.read_text() == "precious"
    if words != ["--report"]:  # that is drawn below
        assert replayed("chase.mcap", *words, "--overwrite", capsys=capsys)[0] == 0
        assert path.read_text() != "precious"


def test_another_ending_is_refused(shown: Shown, capsys: pytest.CaptureFixture[str]) -> None:
    code, told = replayed(str(shown.log.path), "--export", "chase.kml", capsys=capsys)
    assert (code, told) == (2, "swarmchase: --export chase.kml is refused: allowed is one of .geojson, .csv\n")


# The report


class Page(HTMLParser):
    """Its words, and what it would load."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.words, self.loads, self.tags = [], [], []  # type: ignore[var-annotated]
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.loads += [value for name, value in attrs if name in {"src", "href", "srcset", "data"}]

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def test_the_report_is_one_page_that_needs_nothing_else(
    shown: Shown, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "chase.mcap"
    log.write_bytes(shown.log.path.read_bytes())
    (tmp_path / "chase.html").write_text("to be replaced")
    code, told = replayed(str(log), "--report", "--overwrite", capsys=capsys)
    assert (code, told.splitlines()[-1]) == (0, f"The report is {tmp_path / 'chase.html'}.")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["chase.html", "chase.mcap"]
    text = (tmp_path / "chase.html").read_text()
    page = Page(text)
    (picture,) = page.loads
    assert not {"script", "link", "iframe", "object"} & set(page.tags)
    assert "url(" not in text
    kind, _, data = picture.partition(",")
    assert kind == "data:image/png;base64"
    assert Image.open(io.BytesIO(base64.b64decode(data))).width > 1000
    words = " ".join(page.words)
    for event in shown.log.events:
        assert (event.text in words) is (event.severity.value != "routine")
    assert f"reached: {shown.log.reason}" in words
    assert "latitude 47.4, longitude 8.5, altitude 400 m" in words
    assert re.search(r"followed\s*\d+% of \d+ s within 10 m", words)
    assert shown.head.controller in words


# Foxglove


def test_the_scene_draws_what_the_frame_says(shown: Shown) -> None:
    scenes = [json.loads(one.data) for one in messages(shown.log.path) if one.topic == "/chase/scene"]
    for scene, frame in zip(scenes, shown.frames[::FRAMES_A_SCENE], strict=True):
        assert scene["deletions"] == []
        entities: dict[str, SceneEntity] = {one["id"]: one for one in scene["entities"]}
        assert {(one["frame_id"], one["lifetime"]["sec"]) for one in entities.values()} == {(FRAME_ID, 2)}
        estimate = frame["estimate"]
        assert ("estimate" in entities) is (estimate is not None)
        for number, tracker in enumerate(frame["trackers"]):
            drawn = entities[f"tracker {number}"]["spheres"][0]["pose"]["position"]
            assert list(drawn.values()) == tracker["position_m"]
        if estimate is None or estimate["region"] is None:
            continue
        ellipsoid = entities["estimate"]["spheres"][1]
        x, y, z, w = (ellipsoid["pose"]["orientation"][name] for name in ("x", "y", "z", "w"))
        turned = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
        halves_m = np.array(list(ellipsoid["size"].values())) / 2
        axes_m = np.array(estimate["region"]["half_axes_m"])
        # The same quadric, whichever axis comes first.
        assert turned @ np.diag(halves_m**2) @ turned.T == pytest.approx(
            axes_m.T @ axes_m, abs=0.02 * (axes_m**2).sum() + 0.01
        )


def test_an_hour_of_the_log_stays_below_100_megabytes(shown: Shown) -> None:
    assert shown.log.path.stat().st_size / shown.log.seconds * 3600 < 100e6


def test_the_layout_names_what_the_log_has(shown: Shown) -> None:
    """Topics, and fields that messages on them have."""
    layout = json.loads(LAYOUT.read_text())

    def panels(node: Any) -> list[str]:
        return [node] if isinstance(node, str) else panels(node["first"]) + panels(node["second"])

    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])
    newest: dict[str, Any] = {one.topic: json.loads(one.data) for one in messages(shown.log.path)}
    named = re.findall(r'"(/chase/\w+)([\w.\[\]:]*)"', LAYOUT.read_text())
    assert {topic for topic, _ in named} == {"/chase/scene", "/chase/frame", "/chase/event"}
    for topic, fields in named:
        found = newest[topic]
        for name in filter(None, re.split(r"[.\[\]:]+", fields)):
            found = found[int(name)] if name.isdigit() else found[name]
    three_d = next(panel for name, panel in layout["configById"].items() if name.startswith("3D"))
    assert three_d["followTf"] == FRAME_ID
    assert three_d["topics"]["/chase/scene"]["visible"] is True
    assert SCENE_SCHEMA == "foxglove.SceneUpdate"
