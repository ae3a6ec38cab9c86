"""Whose transmissions a receiver hears, and which of them count: those of the device that is chased."""

from collections import Counter
from collections.abc import Collection

from ....errors import InputError
from ....levels import is_level
from ....ranges import shown
from .mac import mac_address

MOST_TRANSMITTERS = 10_000
"""That are remembered: whoever makes up addresses does not fill the memory."""
MOST_NAMES_EACH = 8
MOST_LISTED = 8
LISTEN_S = 3.0
"""So long several are heard before one is asked for: the list then has those that are there."""


class Transmitters:
    """Counts levels by who sent them.

    Args:
        mac: the address of the one that is chased, ``aa:bb:cc:dd:ee:ff``; None where it is not known.
        name: what the one that is chased calls itself, a UAS id of Remote ID or the name of a network. It is known by
            it from the first frame on that says so.

    Raises:
        InputError: ``mac`` is no MAC address.
    """

    def __init__(self, mac: str | None = None, name: str | None = None) -> None:
        self._mac = None if mac is None else mac_address(mac).hex(":")
        self._name = name
        self._levels_dbm: dict[str, Counter[float]] = {}
        self._names: dict[str, list[str]] = {}
        self._several_since_ns: int | None = None

    @property
    def is_chosen(self) -> bool:
        """Whether it is known who is chased."""
        return self._mac is not None or self._name is not None

    @property
    def are_several(self) -> bool:
        """Whether more than one was heard."""
        return len(self._levels_dbm) > 1

    def counts(self, sender: str | None, names: Collection[str], level_dbm: float) -> bool:
        """Whether a level counts.

        Args:
            sender: a MAC address in lower case; where a receiver knows none, a name; None where it knows nothing.
            names: what the sender calls itself in this very transmission.

        Returns:
            Of one that was chosen: whether it is its. Of none chosen: whether no other was ever heard.
        """
        if sender is not None:
            self._remember(sender, names, level_dbm)
        if not self.is_chosen:
            return not self.are_several
        return sender is not None and self._is_chased(sender)

    def require_one(self, what: str) -> None:
        """Ask people to choose.

        Raises:
            InputError: several were heard and none was chosen: with the strongest first.
        """
        if self.are_several and not self.is_chosen:
            raise InputError(
                f"{what} has {len(self._levels_dbm)} transmitters: say which one is chased with --transmitter-mac or "
                f"--transmitter-name. The strongest are {self.strongest()}"
            )

    def require_one_in_time(self, what: str, now_ns: int) -> None:
        """The same of a receiver that goes on listening, once several have been heard for ``LISTEN_S``."""
        if not self.are_several or self.is_chosen:
            return
        if self._several_since_ns is None:
            self._several_since_ns = now_ns
        if now_ns - self._several_since_ns >= LISTEN_S * 1e9:
            self.require_one(what)

    def require_chased(self, what: str) -> None:
        """Of something that was heard to its end.

        Raises:
            InputError: the one that is chased is not in it: with those that are.
        """
        if self.is_chosen and not any(self._is_chased(sender) for sender in self._levels_dbm):
            chased = " and ".join(one for one in (self._mac, self._name) if one is not None)
            there = f"the strongest are {self.strongest()}" if self._levels_dbm else "nobody is"
            raise InputError(f"{chased} is not in {what}: {there}")

    def strongest(self) -> str:
        """By the median of their levels: single ones are garbage."""
        medians = {sender: _median(levels) for sender, levels in self._levels_dbm.items()}
        ranked = sorted(medians, key=lambda sender: (-medians[sender], sender))
        listed = ", ".join(self._shown(sender, medians[sender]) for sender in ranked[:MOST_LISTED])
        return listed + (f" and {len(ranked) - MOST_LISTED} weaker ones" if len(ranked) > MOST_LISTED else "")

    def _is_chased(self, sender: str) -> bool:
        is_it = self._mac is None or sender == self._mac
        return is_it and (self._name is None or self._name in [sender, *self._names.get(sender, [])])

    def _remember(self, sender: str, names: Collection[str], level_dbm: float) -> None:
        if not is_level(level_dbm) or (sender not in self._levels_dbm and len(self._levels_dbm) >= MOST_TRANSMITTERS):
            return
        self._levels_dbm.setdefault(sender, Counter())[float(round(level_dbm))] += 1
        known = self._names.setdefault(sender, [])
        known += [name for name in names if name not in known][: MOST_NAMES_EACH - len(known)]

    def _shown(self, sender: str, median_dbm: float) -> str:
        names = "".join(f", {shown(name)}" for name in self._names[sender] if name != sender)
        return f"{shown(sender)} ({median_dbm:g} dBm{names})"


def _median(levels_dbm: Counter[float]) -> float:
    half = levels_dbm.total() / 2
    below = 0
    for level_dbm in sorted(levels_dbm):
        below += levels_dbm[level_dbm]
        if below >= half:
            return level_dbm
    return float("-inf")
