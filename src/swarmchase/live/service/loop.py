"""The loop around the controller service: keeps its pace, passes on the operator's words, shows what happens, and ends
when the chase has ended.
"""

import time
from collections import deque
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

from ...evaluation.statistics import nearest_rank_percentile
from ...processes.stop_request import StopRequest
from ..link.mavlink import ControllerMavlinkLink
from ..ticker import Ticker
from .chase_state import UNDER_WAY, ChaseState, Decision, Snapshot, Transition
from .operator_words import WORDS, OperatorWord
from .service import ABORT_S, ControllerService, Recorder

STEPS_HZ = 20.0
BREATH_S = 0.002
"""Between two looks at the socket."""
TOLD_S = ABORT_S + 0.2
"""So long after the chase's end trackers have heard of it; the service speaks for ABORT_S."""
MOST_LATENCIES = 10_000
"""No more than the newest of this many are kept."""

Tell = Callable[[str], None]
"""One line for people."""
Words = Callable[[], Sequence[str]]
"""What an operator has said since the last call. Never blocks."""
Watcher = Callable[[Snapshot, float | None], None]
"""Is told the service after every step, and the seconds its decision took if it made one. Neither blocks nor raises."""


class Journal:
    """The service's recorder: notes that a decision was made, and passes all on.

    Args:
        takers: are given every entry, one after the other.
    """

    def __init__(self, takers: Sequence[Recorder] = ()) -> None:
        self.has_decided = False
        self._takers = takers

    def __call__(self, entry: Transition | Decision) -> None:
        """Take in what the service records."""
        self.has_decided |= isinstance(entry, Decision)
        for take in self._takers:
            take(entry)


@dataclass(frozen=True)
class ServeSummary:
    """How a chase ended."""

    state: str
    reason: str
    """Of the last transition."""
    movements: int
    seconds: float
    """Since the loop began."""
    rejected: dict[str, int]
    """Datagrams that the link dropped, by reason."""
    rejected_skew_s: dict[str, dict[str, float]]
    """Where the reason was their time, by reason and sender: see ``RejectedError``, of the newest."""
    decision_latency_p50_ms: float | None
    """See ``ServeLoop.step``; None without a decision."""
    decision_latency_p99_ms: float | None
    following_share: float | None
    """Of the time since a target that is followed was first reached, in which it was believed to be near; None where
    none was."""


class ServeLoop:
    """Runs ``service`` until its chase has ended.

    Args:
        journal: the service's recorder.
        words: where the operator speaks.
        watchers: see the service after every step.
        stay: after REACHED or LOST go on holding the trackers there until the operator aborts or quits.
    """

    def __init__(
        self,
        service: ControllerService,
        link: ControllerMavlinkLink,
        journal: Journal,
        words: Sequence[Words],
        request: StopRequest,
        tell: Tell,
        watchers: Sequence[Watcher] = (),
        stay: bool = False,
    ) -> None:
        self._service, self._link, self._journal, self._words = service, link, journal, words
        self._request, self._tell, self._watchers, self._stay = request, tell, watchers, stay
        self._acts: dict[str, Callable[[], None]] = {
            OperatorWord.START: service.start,
            OperatorWord.OVERRIDE: service.override,
            OperatorWord.HOLD: service.hold,
            OperatorWord.RESUME: service.resume,
            OperatorWord.REACHED: service.declare_reached,
            OperatorWord.ABORT: service.abort,
            OperatorWord.QUIT: self._quit,
        }
        self._quits = False
        self._ended_s: float | None = None
        self._latency_s: deque[float] = deque(maxlen=MOST_LATENCIES)

    def run(self) -> ServeSummary:
        """Until the end of the chase, and so long after it that trackers have heard of it."""
        began_s = time.monotonic()
        ticker = Ticker(STEPS_HZ)
        while not self._has_ended():
            for words in self._words:
                for word in words():
                    self._obey(word)
            if self._request.made and not self._quits:
                self._quit()
            latency_s = self.step()
            snapshot = self._service.snapshot()
            for watch in self._watchers:
                watch(snapshot, latency_s)
            self._listen_until_next(ticker)
        snapshot = self._service.snapshot()
        return ServeSummary(
            state=snapshot.state.value,
            reason=snapshot.reason,
            movements=snapshot.movements,
            seconds=round(time.monotonic() - began_s, 3),
            rejected={str(reason): count for reason, count in sorted(self._link.rejected.items())},
            rejected_skew_s=self._link.rejections.skew_s(),
            decision_latency_p50_ms=percentile_ms(self._latency_s, 50),
            decision_latency_p99_ms=percentile_ms(self._latency_s, 99),
            following_share=None if snapshot.following is None else round(snapshot.following.share, 4),
        )

    def _listen_until_next(self, ticker: Ticker) -> None:
        """Take in what comes at the moment of its coming; a flood gets no more than this share of the time."""
        ticker.next()
        while (left_s := ticker.left_s()) > 0:
            if self._link.wait(left_s):
                self._service.listen()
                time.sleep(min(BREATH_S, ticker.left_s()))

    def step(self) -> float | None:
        """One step of the service. Where it decides, it is timed: the seconds from before the newest samples are taken
        from the socket until the set-points are sent. What samples wait for the step to begin, up to 1 / STEPS_HZ, is
        not in it.
        """
        self._journal.has_decided = False
        began_s = time.perf_counter()
        self._service.step()
        latency_s = time.perf_counter() - began_s
        self._service.explain()
        if not self._journal.has_decided:
            return None
        self._latency_s.append(latency_s)
        return latency_s

    def _obey(self, word: str) -> None:
        act = self._acts.get(word)
        if act is None:
            self._tell(f"no word {word!r}; there are {', '.join(WORDS)}")
        else:
            act()

    def _quit(self) -> None:
        self._quits = True
        if self._service.state in UNDER_WAY or self._service.state is ChaseState.IDLE:
            self._service.abort()

    def _has_ended(self) -> bool:
        state = self._service.state
        if state in UNDER_WAY or state is ChaseState.IDLE:
            return False
        if self._stay and not self._quits and state is not ChaseState.ABORTED:
            self._ended_s = None
            return False
        now_s = time.monotonic()
        self._ended_s = now_s if self._ended_s is None else self._ended_s
        return now_s - self._ended_s >= TOLD_S


def percentile_ms(seconds: Collection[float], percent: int) -> float | None:
    """The least value that so many per cent do not exceed, in milliseconds; None of nothing."""
    if not seconds:
        return None
    return round(1000 * nearest_rank_percentile(list(seconds), percent), 3)
