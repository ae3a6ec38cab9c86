"""What is a level, decided here for every receiver, link, simulator and controller; what is none is missing (NaN).

Receivers put error values among their levels: 0 for "no signal" (Kismet, ESP32, SiK radios, radiotap), 31 (the ESP32's
"cannot be read"), 127 (Bluetooth HCI: "not available") and -128 (the lowest signed byte). Others lie outside what any
receiver reports. What passes for a level at a receiver may still be more than the scenario's transmitter can give:
+17 dBm are a level near a broadcasting mast, and garbage in a chase after a UAV's telemetry radio. And a level that its
transmitter can give may stand so far above all others of its window that it is none of them.
"""

import math
from enum import StrEnum
from typing import Any

from .scenario import Scenario

LOWEST_DBM, HIGHEST_DBM = -200.0, 50.0
"""No receiver reports anything outside."""
ERROR_VALUES_DBM = (0.0, 31.0, 127.0, -128.0)
TOO_RARE = 1e-6
"""A sample that fading makes as strong less often is none."""
HALF_STEP_DB = 0.5
"""Receivers report whole decibels."""
POWER_ALLOWANCE_DB = 6.0
"""Nobody knows a transmitter's power and its antenna better than that."""
WILD_DB = 20.0
"""What is so far above the upper quartile of its window is wild. Of a million full windows of any scenario's fading,
line of sight or none, fewer than one has such a sample (the most in 180,000 was 14.6 dB)."""
FEWEST_TO_COMPARE = 3
"""Of two samples nobody can say which is the wild one."""


class NoLevel(StrEnum):
    """Why what a receiver reports is no level."""

    NOTHING_HEARD = "nothing heard"
    """NaN: it says so itself."""
    ERROR_VALUE = "an error value"
    OUT_OF_RANGE = "beyond any receiver"
    TOO_STRONG = "stronger than the transmitter can be"
    WILD = "far above its window"


def is_level(reported_dbm: Any, highest_dbm: float = HIGHEST_DBM) -> Any:
    """Whether it is one: a bool for a number, an array or tensor of them for an array or tensor.

    Args:
        highest_dbm: ``highest_dbm(scenario)`` where the transmitter is known.
    """
    found = (reported_dbm >= LOWEST_DBM) & (reported_dbm <= highest_dbm)
    for error_dbm in ERROR_VALUES_DBM:
        found = found & (reported_dbm != error_dbm)
    return found


def why_no_level(reported_dbm: float) -> NoLevel:
    """The reason for a number of which ``is_level`` says that it is none."""
    if math.isnan(reported_dbm):
        return NoLevel.NOTHING_HEARD
    if reported_dbm in ERROR_VALUES_DBM:
        return NoLevel.ERROR_VALUE
    return NoLevel.TOO_STRONG if LOWEST_DBM <= reported_dbm <= HIGHEST_DBM else NoLevel.OUT_OF_RANGE


def quartile_place(num_levels: Any) -> Any:
    """Which of so many levels, counted from 0 for the lowest, is their upper quartile: no wild one unless a quarter
    are."""
    return (num_levels - 1) * 3 // 4


def level_or_nan(reported_dbm: float) -> float:
    """The level itself, or NaN where it is none."""
    return reported_dbm if is_level(reported_dbm) else math.nan


def highest_dbm(scenario: Scenario) -> float:
    """The most that a receiver can report of the scenario's transmitter.

    At d_0, with the line of sight and the scattered part of the fading (Eqs. 3-4) in phase: |h| is at most
    sqrt(K / (K + 1)) + sqrt(-ln p / (K + 1)) but for a share p of the samples, since |z|^2 is exponential.
    """
    line_of_sight = math.sqrt(scenario.rician_k / (scenario.rician_k + 1))
    scattered = math.sqrt(-math.log(TOO_RARE) / (scenario.rician_k + 1))
    unfaded_dbm = scenario.transmit_power_dbm - scenario.reference_path_loss_db
    fading_db = 20 * math.log10(line_of_sight + scattered)
    allowance_db = POWER_ALLOWANCE_DB + scenario.receiver_offset_db + HALF_STEP_DB
    return min(HIGHEST_DBM, unfaded_dbm + fading_db + allowance_db)
