#!/usr/bin/env python3
"""A tracker of the live system that needs nothing but pymavlink: docs/link.md and no line of swarmchase.

    pip install pymavlink
    swarmchase keys swarm.keys && swarmchase serve --keys swarm.keys --start
    python examples/pymavlink_tracker.py --number 0 --keys swarm.keys --place 3 0 20

Its vehicle is a point that flies straight to each set-point, and its receiver hears one level all the time. Put your
own in their place. It runs until it is killed.
"""

import argparse
import math
import os
import time

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil

SECONDS_TO_2015 = 1_420_070_400
STEP_S = 0.1
SPEED_MPS = 5.0
HOLD_AFTER_S = 1.0
ARMED, SIMULATED = 128, 32
"""Of the vehicle: leave the second away with a real one."""
FRESH, MOST_AHEAD = 200_000, 6_000_000
"""2 s and a minute, in the units of signatures: 10 us."""


class Tracker:
    """One tracker at one controller.

    Args:
        place: where it begins: east, north and up, in metres.
    """

    def __init__(self, number, key, controller, place, level_dbm, sampling_hz):
        self.number, self.place, self.goal = number, place, None
        self.moves_mps, self.valid_s, self.obeyed_ms = (0.0, 0.0, 0.0), 0.0, None
        self.level_dbm, self.sampling_hz = level_dbm, sampling_hz
        self.epoch, self.told_s = -1, -math.inf
        self.signed = self.heard = 0
        self.link = mavutil.mavlink_connection(
            f"udpout:{controller}", source_system=number + 1, source_component=191, dialect="common"
        )
        self.link.setup_signing(key, link_id=0)

    def run(self):
        """Fly, report and listen, ten times a second."""
        while True:
            self.listen()
            self.fly()
            self.report()
            time.sleep(STEP_S)

    def listen(self):
        """Obey the newest controller's newest set-point."""
        while (message := self.received()) is not None:
            if message.get_type() != "SET_POSITION_TARGET_LOCAL_NED" or not self.is_fresh(message):
                continue
            epoch = 65_536 * int(message.afx) + int(message.afy)
            if epoch >= self.epoch:
                self.epoch, self.told_s = epoch, time.monotonic()
                self.goal = (message.y, message.x, -message.z)
                self.moves_mps, self.valid_s = (message.vy, message.vx, -message.vz), message.yaw
                self.obeyed_ms = message.time_boot_ms

    def received(self):
        """The next message, of which pymavlink has checked the signature only."""
        # A forged packet enters a far time here, signature or not, and would silence the controller.
        self.link.mav.signing.stream_timestamps.clear()
        return self.link.recv_msg()

    def is_fresh(self, message):
        """Signed, newer than the last, and of now."""
        signed = int.from_bytes(message.get_msgbuf()[-12:-6], "little")
        if not message.get_signed() or not max(self.heard + 1, now() - FRESH) <= signed <= now() + MOST_AHEAD:
            return False
        self.heard = signed
        return True

    @property
    def follows(self):
        """Whether a controller speaks, or has said that the way goes on without it."""
        return time.monotonic() - self.told_s < max(HOLD_AFTER_S, self.valid_s)

    def fly(self):
        """A step towards the goal, which moves on for as long as the controller has said."""
        if not self.follows:
            return
        moved_s = min(time.monotonic() - self.told_s, self.valid_s)
        goal = tuple(there + moved_s * speed for there, speed in zip(self.goal, self.moves_mps, strict=True))
        left_m = math.dist(self.place, goal)
        share = min(1.0, SPEED_MPS * STEP_S / left_m) if left_m else 0.0
        self.place = tuple(here + share * (there - here) for here, there in zip(self.place, goal, strict=True))

    def report(self):
        """What is heard, where it is, and whether it follows."""
        uptime_s = time.monotonic()
        levels = [self.level_dbm] * 50
        obeyed = [0, 0, 0] if self.obeyed_ms is None else [1, *divmod(self.obeyed_ms, 65_536)]
        data = [self.sampling_hz, len(levels), *obeyed, 0.0, 0.0, 0.0, *levels]
        east, north, up = self.place
        uptime_ms = int(1000 * uptime_s) % 2**32
        mode = 8 if self.follows else 16
        self.send(mavutil.mavlink.MAVLink_debug_float_array_message(int(1e6 * uptime_s), b"rssi_dbm", 1, data))
        self.send(mavutil.mavlink.MAVLink_local_position_ned_message(uptime_ms, north, east, -up, 0.0, 0.0, 0.0))
        self.send(mavutil.mavlink.MAVLink_heartbeat_message(18, 8, 1 | mode | ARMED | SIMULATED, uptime_ms, 4, 3))

    def send(self, message):
        """Signed at real time, which pymavlink by itself reads once only."""
        self.signed = max(self.signed + 1, now())
        self.link.mav.signing.timestamp = self.signed
        self.link.mav.send(message)


def now():
    """Real time as signatures have it: in 10 us since 2015."""
    return int((time.time() - SECONDS_TO_2015) * 100_000)


def key_of(number, path):
    """The tracker's key in a key file."""
    with open(path, encoding="ascii") as file:
        lines = [line.split() for line in file if not line.startswith("#")]
    return next(bytes.fromhex(words[1]) for words in lines if words and int(words[0]) == number)


def main():
    """Be one tracker."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--number", type=int, required=True, help="0 to 5")
    parser.add_argument("--keys", required=True, help="a key file that holds its key")
    parser.add_argument("--service", default="127.0.0.1:14550", help="HOST:PORT of swarmchase serve")
    parser.add_argument("--place", type=float, nargs=3, required=True, help="east, north, up in m: where it begins")
    parser.add_argument("--level-dbm", type=float, default=-60.0, help="what its receiver hears")
    parser.add_argument("--sampling-hz", type=float, default=10.0, help="the same as the controller's")
    options = parser.parse_args()
    key = key_of(options.number, options.keys)
    tracker = Tracker(
        options.number, key, options.service, tuple(options.place), options.level_dbm, options.sampling_hz
    )
    tracker.run()


if __name__ == "__main__":
    main()
