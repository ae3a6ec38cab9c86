"""A flight that the real service flies while all outputs show it to listeners on real sockets."""

import json
import math
import socket
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from live.outputs.listeners import Broker, CotListener
from page_frames import FLIGHT, head_for
from swarmchase.controllers import load_controller
from swarmchase.live.audience import Audience, AudienceOptions
from swarmchase.live.earth import EarthOrigin
from swarmchase.live.frame import Frame
from swarmchase.live.log.entries import LogHead
from swarmchase.live.log.recording import Recording, read_recording
from swarmchase.live.outputs.kind import OutputDetails
from swarmchase.live.service.chase_state import Snapshot
from swarmchase.live.service.settings import ServiceSettings
from swarmchase.simulation.fault_plan import fault_plan
from swarmchase.simulation.site import site_limits
from swarmchase.simulation.virtual_chase import VirtualChase

ORIGIN = EarthOrigin(47.4, 8.5, 400.0)
DETAILS = OutputDetails(ORIGIN, geoid_height_m=47.5, is_simulated=True, station="here")
CHASE_S = 9.0
"""The target is reached after 7 s and followed for a second."""


NOBODY = "cot-tcp:127.0.0.1:1"
"""No service of this machine has the port."""


@dataclass
class Shown:
    """A chase that was flown, and what became of it elsewhere."""

    head: LogHead
    log: Recording
    frames: list[Frame]
    told: list[str]
    udp: CotListener
    tcp: CotListener
    broker: Broker
    lines: list[Any]


def shown_chase(folder: Path) -> Shown:
    """The real service with its audience, on a made clock: every second it waits until all have heard."""
    udp, tcp, broker = CotListener(socket.SOCK_DGRAM), CotListener(socket.SOCK_STREAM), Broker()
    limits = site_limits(FLIGHT)
    head = replace(head_for("particle", limits, FLIGHT), origin=ORIGIN)
    controller = load_controller("particle", FLIGHT)
    plan, followed = fault_plan("silent=2@1-3"), ServiceSettings(follow=True)
    chase = VirtualChase(FLIGHT, controller, 3, 0, plan, limits=limits, settings=followed, starts=False)
    outputs = (
        NOBODY,
        f"cot-udp:127.0.0.1:{udp.port}",
        f"cot-tcp:127.0.0.1:{tcp.port}",
        f"jsonl:{folder / 'estimate.jsonl'}",
        f"mqtt:127.0.0.1:{broker.port}/site/target",
    )
    told: list[str] = []
    options = AudienceOptions(None, folder / "chase.mcap", outputs, DETAILS)
    audience = Audience(options, head, chase.link, told.append, lambda: chase.site.radio.target_m)

    def watch(snapshot: Snapshot) -> None:
        chase.service.explain()
        for watcher in audience.watchers:
            watcher(chase.service.snapshot(), None)

    chase._recorder, chase._watch = audience.journal, watch
    chase.service.start()
    for second in range(math.ceil(CHASE_S)):
        while (chase.clock.now_ns() - head.began_ns) / 1e9 < second + 1:
            chase.tick()
        udp.wait_for_more_than(second, udp.events)
        tcp.wait_for_more_than(second, tcp.events)
        broker.wait_for_more_than(second, broker.published)
    audience.close()
    for listener in (udp, tcp, broker):
        listener.close()
    log = read_recording(folder / "chase.mcap")
    lines = [json.loads(line) for line in (folder / "estimate.jsonl").read_text().splitlines()]
    return Shown(head, log, list(log.frames()), told, udp, tcp, broker, lines)


def frame_of(shown: Shown, time: str) -> Frame:
    """The one that was taken then."""
    since_s = datetime.fromisoformat(time).timestamp() - shown.head.started_at.timestamp()
    return min(shown.frames, key=lambda frame: abs(frame["time_s"] - since_s))


def copy_at(frame: Frame, time_s: float) -> Frame:
    """The same at another time."""
    return Frame(**{**frame, "time_s": time_s})  # type: ignore[typeddict-item]


def metres(event: ElementTree.Element) -> tuple[float, float, float]:
    """Its place in the shared frame."""
    point = event.find("point")
    assert point is not None
    height_m = float(point.attrib["hae"]) - DETAILS.geoid_height_m
    return ORIGIN.metres((float(point.attrib["lat"]), float(point.attrib["lon"]), height_m))
