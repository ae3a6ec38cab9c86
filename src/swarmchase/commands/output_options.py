"""Where a live chase is shown beside its page and its log, and where on the earth it is."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from ..live.address import help_of
from ..live.outputs.kind import KINDS

if TYPE_CHECKING:
    from ..live.audience import AudienceOptions


@dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """Of a live chase."""

    output: Annotated[
        tuple[str, ...],
        arg(help=f"One or several of {help_of(KINDS)}. One that cannot be reached never holds up the chase."),
    ] = ()
    global_origin: tuple[float, float, float] | None = None
    """Latitude and longitude in degrees, altitude in m above sea level where x, y, z are 0: for outputs and the log."""
    geoid_height_m: float = 0.0
    """Of the sea level above the ellipsoid of WGS 84 there, which outputs count heights from."""

    mqtt_password_file: Path | None = None
    """Holds the password of the user that output mqtt names."""

    def audience(self, page: str | None, log: Path | None, is_simulated: bool) -> "AudienceOptions":
        """Who follows the chase.

        Raises:
            InputError: the origin is not on the earth.
        """
        from ..live.audience import AudienceOptions
        from ..live.earth import EarthOrigin
        from ..live.outputs.kind import OutputDetails

        origin = None if self.global_origin is None else EarthOrigin(*self.global_origin)
        details = OutputDetails(origin, self.geoid_height_m, is_simulated, self.mqtt_password_file)
        return AudienceOptions(page, log, self.output, details)
