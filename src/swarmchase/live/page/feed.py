"""Between the chase and the browsers: frames one way, the operator's words the other. No side waits for the other."""

import json
import math
import threading
import time
from collections import deque
from dataclasses import dataclass
from typing import Any

from ..frame import Frame
from ..service.operator_words import WORDS
from .history import History, pack, unpack

MOST_WORDS = 100
"""That wait to be read; what comes after is dropped."""


@dataclass(frozen=True)
class NewestFrame:
    """The frame that was published last."""

    number: int
    """Counts all that were published, from 1."""
    text: str
    """The frame's JSON."""
    age_s: float
    """Since it was published."""
    first_s: float
    """The time of the first frame that the history holds."""
    last_s: float


class Feed:
    """Takes in a chase's frames and gives out what the operator says. Thread-safe; no call waits for a browser.

    Args:
        info: plain JSON that holds for the whole chase: ``version``, ``controller``, ``sampling_hz``,
            ``spatial_correlation``, ``window_samples``, ``success_radius_m``, ``spacing_choices_m``,
            ``displacement_choices_m``, ``is_in_flight``, ``title``,
            ``fence_m`` (``{"low": [x, y, z], "high": [x, y, z]}`` or null) and, where it is known, ``duration_s``.
        is_live: the frames come as they happen, and words are accepted; otherwise it is a recorded chase.
    """

    def __init__(self, info: dict[str, Any], *, is_live: bool) -> None:
        self.info = info
        self.is_live = is_live
        self._lock = threading.Lock()
        self._history = History()
        self._newest_text = ""
        self._published_s = 0.0
        self._number = 0
        self._words: deque[str] = deque()

    def publish(self, frame: Frame) -> None:
        """The newest frame; it enters the history, too."""
        text = _json(frame)
        packed = pack(text)
        with self._lock:
            self._history.add(frame["time_s"], packed)
            self._newest_text, self._published_s = text, time.monotonic()
            self._number += 1

    def words(self) -> list[str]:
        """What the operator has said since the last call."""
        with self._lock:
            words = list(self._words)
            self._words.clear()
        return words

    def say(self, word: str) -> None:
        """The operator says this word. What is no word of ``WORDS``, or meant for a recorded chase, is dropped."""
        with self._lock:
            if self.is_live and word in WORDS and len(self._words) < MOST_WORDS:
                self._words.append(word)

    def newest(self, after_number: int = 0) -> NewestFrame | None:
        """The newest frame; None where it is no newer than this number."""
        with self._lock:
            span_s = self._history.span_s
            if span_s is None or self._number <= after_number:
                return None
            return NewestFrame(self._number, self._newest_text, time.monotonic() - self._published_s, *span_s)

    def past(self, time_s: float) -> str | None:
        """The JSON of the frame next to this time; None before the first."""
        with self._lock:
            packed = self._history.nearest(time_s)
        return None if packed is None else unpack(packed)


def _json(frame: Frame) -> str:
    """The frame's JSON, in which what is not finite is null: a browser reads no NaN."""
    try:
        return json.dumps(frame, allow_nan=False, separators=(",", ":"))
    except ValueError:
        return json.dumps(_finite(frame), allow_nan=False, separators=(",", ":"))


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_finite(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
