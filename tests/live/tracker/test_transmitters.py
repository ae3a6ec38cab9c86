"""Records that say whose transmission they are: of another device than the one that is chased they do not count."""

import pytest

from swarmchase.errors import InputError
from swarmchase.live.tracker.sources.json_records import JsonRecords
from swarmchase.live.tracker.sources.kind import SourceDetails

CHASED = "02:00:00:00:00:0a"


@pytest.mark.parametrize(
    ("transmitter_mac", "said", "counts"),
    [
        (CHASED, ', "mac": "02:00:00:00:00:0a"', True),
        (CHASED, ', "mac": "02:00:00:00:00:0A"', True),
        (CHASED, ', "mac": "02:00:00:00:00:0b"', False),
        (CHASED, "", True),  # a receiver that cannot tell
        (CHASED, ', "mac": null', True),
        (None, ', "mac": "02:00:00:00:00:0b"', True),
    ],
)
def test_only_the_chased_device_counts_where_records_say_whose_they_are(
    transmitter_mac: str | None, said: str, counts: bool
) -> None:
    records = JsonRecords(SourceDetails(same_clock=True, transmitter_mac=transmitter_mac))
    sample = records.sample(f'{{"rssi_dbm": -60, "time_ns": 7{said}}}'.encode(), 9)
    assert sample == ((7, -60.0) if counts else None)
    assert records.rejected == ({} if counts else {"of another transmitter": 1})


@pytest.mark.parametrize("said", ["7", '"nobody"', "[1]", '"02:00:00:00:00"'])
def test_a_mac_that_is_none_is_no_record(said: str) -> None:
    records = JsonRecords(SourceDetails(transmitter_mac=CHASED))
    assert records.sample(f'{{"rssi_dbm": -60, "mac": {said}}}'.encode(), 9) is None
    assert sum(records.rejected.values()) == 1


def test_a_device_that_cannot_be_is_refused() -> None:
    with pytest.raises(InputError, match="allowed is a MAC address"):
        JsonRecords(SourceDetails(transmitter_mac="nobody"))
