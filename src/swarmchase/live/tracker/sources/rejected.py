"""What a source has taken in that was no sample: how many of which kind, and what they held instead."""

from collections import Counter

MOST_SEEN = 8
"""Examples kept of each reason: enough to recognise one's own mistake by."""


class Rejected(Counter[str]):
    """Counts by reason."""

    def __init__(self) -> None:
        super().__init__()
        self._seen: dict[str, list[str]] = {}

    def add(self, reason: str, *seen: str) -> None:
        """Count one more, which held these instead."""
        self[reason] += 1
        known = self._seen.setdefault(reason, [])
        known += [one for one in seen if one not in known][: MOST_SEEN - len(known)]

    def seen(self, reason: str) -> list[str]:
        """What those that were rejected for this reason held, each once, the first few."""
        return list(self._seen.get(reason, []))
