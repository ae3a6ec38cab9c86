"""How often something counted by name happens now: what has been counted for hours says nothing of this moment."""

from collections import Counter, deque
from collections.abc import Mapping

SPAN_S = 10.0
"""Rates are over so long."""
STEP_S = 1.0
"""They are taken anew so often."""


class Rates:
    """Told counts that only grow, again and again, it knows how much they have grown of late."""

    def __init__(self) -> None:
        self._counted: deque[tuple[int, Counter[str]]] = deque()
        self._last: Counter[str] = Counter()
        self.per_second: dict[str, float] = {}
        """By name, those that have happened in the last ``SPAN_S``, in the order of their names."""

    def take(self, counts: Mapping[str, int], time_ns: int) -> None:
        """Take in what has been counted until now. What begins is known at once, how often it happens once a second."""
        if not self._counted:
            # What was counted before the first look has happened since.
            self._counted.append((time_ns, Counter()))
        newest_ns, _ = self._counted[-1]
        is_due = time_ns - newest_ns >= STEP_S * 1e9
        begins = any(counts[name] > self._last[name] and name not in self.per_second for name in counts)
        self._last = Counter(counts)
        if not (is_due or begins):
            return
        if is_due:
            self._counted.append((time_ns, Counter(counts)))
            while len(self._counted) > 1 and time_ns - self._counted[0][0] > SPAN_S * 1e9:
                self._counted.popleft()
        since_ns, before = self._counted[0]
        seconds = max((time_ns - since_ns) / 1e9, STEP_S)
        grown = {name: counts[name] - before[name] for name in sorted(counts)}
        self.per_second = {name: number / seconds for name, number in grown.items() if number > 0}


def in_words(per_second: Mapping[str, float]) -> str:
    """``wrong key 12/s, giant 0.3/s``, the most frequent first."""
    ordered = sorted(per_second.items(), key=lambda one: (-one[1], one[0]))
    return ", ".join(f"{name} {rate:.0f}/s" if rate >= 10 else f"{name} {rate:.1f}/s" for name, rate in ordered)
