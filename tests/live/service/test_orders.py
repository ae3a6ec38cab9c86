"""Which of the set-points that a tracker may have heard last is next to where it says that it is: by pencil."""

import math

import numpy as np
import pytest

from swarmchase.live.service.orders import KEPT_S, Braking, Onward, Told

SECOND_NS = 10**9
START_NS = 1_000 * SECOND_NS
BRAKING = Braking(4.0, 5.0)


def told(*sent_x_m: float, onward: Onward | None = None) -> Told:
    """All six are sent to these places, one after the other, a second apart, the last of them now."""
    orders = Told()
    for number, x_m in enumerate(sent_x_m, start=1 - len(sent_x_m)):
        orders.note(START_NS + number * SECOND_NS, np.tile([x_m, 0.0, 0.0], (6, 1)), onward)
    return orders


@pytest.mark.parametrize(
    ("obeyed_s_ago", "at_x_m", "nearest_x_m"),
    [
        (2.0, 9.0, 10.0),
        (2.0, 4.0, 0.0),
        (2.0, 19.0, 20.0),
        (1.0, 1.0, 10.0),  # what was sent before is obeyed no more
        (0.0, 1.0, 20.0),
        (None, 1.0, 0.0),  # nobody knows what it has heard
        (99.0, 1.0, 0.0),
        (2.0, math.nan, math.nan),
    ],
)
def test_it_is_the_nearest_of_those_since_the_last_that_it_has_obeyed(
    obeyed_s_ago: float | None, at_x_m: float, nearest_x_m: float
) -> None:
    obeyed_ns = None if obeyed_s_ago is None else START_NS - round(obeyed_s_ago * SECOND_NS)
    places_m = np.tile([at_x_m, 0.0, 0.0], (6, 1))
    nearest_m = told(0.0, 10.0, 20.0).nearest_m(START_NS, [obeyed_ns] * 6, places_m)
    expected_m = [nearest_x_m, 0.0, 0.0] if math.isfinite(nearest_x_m) else [math.nan] * 3
    np.testing.assert_allclose(nearest_m, np.tile(expected_m, (6, 1)))


def test_each_has_its_own() -> None:
    obeyed_ns = [START_NS - number * SECOND_NS for number in (0, 1, 2, 0, 1, 2)]
    nearest_m = told(0.0, 10.0, 20.0).nearest_m(START_NS, obeyed_ns, np.zeros((6, 3)))
    assert nearest_m[:, 0].tolist() == [20.0, 10.0, 0.0, 20.0, 10.0, 0.0]


def test_set_points_move_on_for_as_long_as_they_are_valid() -> None:
    """Sent two seconds ago, 3 m/s, valid for one second: it is 3 m further."""
    onward = Onward(np.array([0.0, 3.0, 0.0]), np.ones(6), BRAKING)
    nearest_m = told(0.0, 50.0, 50.0, onward=onward).nearest_m(START_NS, [None] * 6, np.zeros((6, 3)))
    np.testing.assert_allclose(nearest_m, np.tile([0.0, 3.0, 0.0], (6, 1)))


def test_nothing_was_sent_and_what_was_is_forgotten() -> None:
    assert np.isnan(Told().nearest_m(START_NS, [None] * 6, np.zeros((6, 3)))).all()
    orders = told(0.0, 10.0)
    later_ns = START_NS + round((KEPT_S - 0.5) * SECOND_NS)
    orders.note(later_ns, np.tile([50.0, 0.0, 0.0], (6, 1)), None)
    assert orders.nearest_m(later_ns, [None] * 6, np.zeros((6, 3)))[:, 0].tolist() == [10.0] * 6
