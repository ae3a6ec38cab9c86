"""What a controller says of itself in its memory, chase by chase, when a window is no good or its estimate fails."""

from enum import IntEnum


class Condition(IntEnum):
    """Kept as an int64 tensor [chase] in the field ``condition`` of a controller's memory."""

    TRACKING = 0
    """All is well."""
    DEAF = 1
    """No tracker had a valid sample in the last window: the controller holds still, or flies on to where it
    expects the target."""
    LOST = 2
    """What was heard contradicted its estimate: it has begun anew from where it is."""
