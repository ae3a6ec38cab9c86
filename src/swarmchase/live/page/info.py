"""What a page shows of a chase beside its frames."""

from typing import Any

from ..log.entries import LogHead


def page_info(head: LogHead) -> dict[str, Any]:
    """For ``page.feed.Feed``: plain JSON."""
    scenario, limits = head.scenario, head.limits
    return {
        "version": head.version,
        "controller": head.controller,
        "sampling_hz": scenario.sampling_hz,
        "spatial_correlation": scenario.spatial_correlation,
        "window_samples": scenario.window_samples,
        "success_radius_m": scenario.success_radius_m,
        "spacing_choices_m": list(scenario.spacing_choices_m),
        "displacement_choices_m": list(scenario.displacement_choices_m),
        "is_in_flight": scenario.pace == "listen_in_flight",
        "fence_m": {"low": limits.low_m.tolist(), "high": limits.high_m.tolist()},
        "title": f"chase {head.chase} of seed {head.seed}, {head.started_at:%Y-%m-%d %H:%M:%S} UTC",
    }
