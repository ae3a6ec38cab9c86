"""What is said of a source that yields no level: what it saw instead."""

from collections import Counter

from .protocol import RssiSource

PATIENCE_S = 5.0
"""A source that has yielded no level for so long is complained of."""


class Complaint:
    """Of one source. Told after each reading how it went, it knows since when nothing came of it."""

    def __init__(self, source: RssiSource) -> None:
        self._source = source
        self._since_ns: int | None = None
        self._counted: Counter[str] = Counter()
        """What had been rejected and dropped by then."""

    def listened(self, heard: bool, dropped: Counter[str], now_ns: int) -> None:
        """The source has been read.

        Args:
            heard: whether any level came of it.
            dropped: all samples so far that were no levels, by reason.
        """
        if heard:
            self._since_ns, self._counted = now_ns, self._source.rejected + dropped
        elif self._since_ns is None:
            self._since_ns = now_ns

    def text(self, dropped: Counter[str], now_ns: int) -> str | None:
        """In words; None where a level came a moment ago."""
        if self._since_ns is None or now_ns - self._since_ns < PATIENCE_S * 1e9:
            return None
        seconds = round((now_ns - self._since_ns) / 1e9)
        counts = self._source.rejected + dropped - self._counted
        if not counts:
            return f"for {seconds} s {self._source.silence}"
        kinds = ", ".join(f"{count} {reason}{self._examples(reason)}" for reason, count in counts.most_common())
        return f"for {seconds} s no level among {counts.total()} records: {kinds}"

    def _examples(self, reason: str) -> str:
        seen = self._source.rejected.seen(reason)
        return f" (seen: {', '.join(seen)})" if seen else ""
