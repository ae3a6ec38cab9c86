"""The share of packets that get lost, counted by hand."""

import pytest

from swarmchase.live.link.loss import MOST_REMEMBERED, LossMeter


@pytest.mark.parametrize(
    ("numbers", "share"),
    [
        ([], None),
        ([7], None),
        ([7, 8, 9, 10], 0.0),
        ([7, 8, 10], 0.25),  # 9 of four
        ([254, 255, 0, 1], 0.0),  # the byte begins anew
        ([254, 1], 0.5),  # 255 and 0 of four
        ([0, *range(2, 102)], 0.0),  # the gap is older than what is remembered
        ([0, 200], 0.99),  # a restart looks like this
        ([0, 200, *range(201, 256), *range(50)], 0.0),  # and is forgotten
    ],
)
def test_what_lies_between_the_numbers_is_lost(numbers: list[int], share: float | None) -> None:
    meter = LossMeter()
    for number in numbers:
        meter.heard(number)
    assert meter.share == share


def test_half_of_many() -> None:
    meter = LossMeter()
    for number in range(0, 10 * MOST_REMEMBERED, 2):
        meter.heard(number % 256)
    assert meter.share == 0.5
