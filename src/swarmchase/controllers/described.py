"""What a controller says of itself in an interactive session."""

from ..scenario import Scenario


class Described:
    """In one line what it is and what it was told."""

    name: str
    _scenario: Scenario

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name!r}, told {self._scenario!r}>"
