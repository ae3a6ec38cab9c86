"""pymavlink's messages, or one clear line if it is not installed.

The dialect alone is imported: the rest of pymavlink brings far more than a small computer on a tracker needs.
"""

from ...errors import InputError

try:
    from pymavlink.dialects.v20 import common as mavlink
except ImportError as error:
    raise InputError("the MAVLink link needs pymavlink: pip install 'swarmchase[live]'") from error

__all__ = ["mavlink"]
