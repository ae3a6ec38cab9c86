"""The scenario: Table I as printed, files that come back equal, refusals that say what was wrong."""

import dataclasses
import json
import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmchase.errors import InputError
from swarmchase.scenario import (
    SPEED_OF_LIGHT_MPS,
    Scenario,
    doppler_spread_from_speed_hz,
    load_scenario,
    paper_scenario,
)

TABLE_I = {
    "transmit_power_dbm": 23.0,
    "reference_distance_m": 1.0,
    "reference_path_loss_db": 30.0,
    "path_loss_exponent": 2.6,
    "rician_k": 3.0,
    "doppler_spread_hz": 1.0,
    "window_samples": 50,
    "success_radius_m": 2.0,
    "max_movements": 500,
}
SECTIONS_III_AND_IV = {
    "start_distance_m": 100.0,
    "spacing_choices_m": (1.0, 2.0, 3.0, 4.0, 5.0),
    "displacement_choices_m": (-4.0, -2.0, 0.0, 2.0, 4.0),
    "tracker_speed_mps": 5.0,
}
OWN_CHOICES = {
    "sampling_hz": 10.0,  # the paper varies these two
    "spatial_correlation": 0.9,
    "los_phase": "common",
    "continuity": "independent",
    "initial_spacing_m": 5.0,
    "receiver_offset_db": 0.0,
    "missing_sample_share": 0.0,
    "silent_trackers": 0,
}

PAPER_FIELDS = TABLE_I.keys() | SECTIONS_III_AND_IV.keys() | OWN_CHOICES.keys()


def test_paper_scenario_is_table_one() -> None:
    assert {
        name: getattr(paper_scenario(), name) for name in PAPER_FIELDS
    } == TABLE_I | SECTIONS_III_AND_IV | OWN_CHOICES


def test_what_departs_from_the_paper_is_off_and_is_written_where_it_is_on() -> None:
    assert set(paper_scenario().to_dict()) == PAPER_FIELDS
    flying = paper_scenario(behaviour="flee", target_speed_mps=5.0, alert_distance_m=50.0)
    assert set(flying.to_dict()) == PAPER_FIELDS | {"behaviour", "target_speed_mps", "alert_distance_m"}
    assert Scenario.from_dict(flying.to_dict()) == flying


@pytest.mark.parametrize("field", dataclasses.fields(Scenario), ids=lambda field: field.name)
def test_every_field_says_where_it_comes_from(field: "dataclasses.Field[Any]") -> None:
    source = field.metadata["source"]
    assert ("Table I" in source) == (field.name in TABLE_I)
    if field.name in PAPER_FIELDS:
        assert (source == "choice") == (field.name in OWN_CHOICES.keys() - {"sampling_hz", "spatial_correlation"})
    assert source
    assert field.metadata["help"].endswith(".")


@pytest.mark.parametrize(
    ("speed_mps", "carrier_hz", "doppler_hz"),
    [(0.1, 3e9, 1.0), (5.0, 3e9, 50.0), (0.0, 3e9, 0.0), (5.0, 2.4e9, 40.0), (SPEED_OF_LIGHT_MPS, 3e9, 3e9)],
)
def test_doppler_is_speed_over_wavelength(speed_mps: float, carrier_hz: float, doppler_hz: float) -> None:
    assert doppler_spread_from_speed_hz(speed_mps, carrier_hz) == pytest.approx(doppler_hz, rel=1e-3)


@pytest.mark.parametrize(("sampling_hz", "window_s"), [(10, 5.0), (20, 2.5), (50, 1.0), (100, 0.5)])
def test_a_window_lasts_its_samples_over_the_frequency(sampling_hz: float, window_s: float) -> None:
    assert paper_scenario(sampling_hz=sampling_hz).window_s == window_s


@pytest.mark.parametrize(
    ("field", "value", "allowed"),
    [
        ("sampling_hz", 0, "greater than 0"),
        ("sampling_hz", -10.0, "greater than 0"),
        ("sampling_hz", float("nan"), "greater than 0"),
        ("sampling_hz", float("inf"), "greater than 0"),
        ("sampling_hz", "ten", "greater than 0"),
        ("sampling_hz", True, "greater than 0"),
        ("sampling_hz", None, "greater than 0"),
        ("sampling_hz", [10.0], "greater than 0"),
        ("sampling_hz", 10**309, "greater than 0"),  # no float is so large
        ("spatial_correlation", -0.1, "between 0 and 1"),
        ("spatial_correlation", 1.1, "between 0 and 1"),
        ("rician_k", -1e-9, "at least 0"),
        ("doppler_spread_hz", -1, "between 0 and 1000"),
        ("transmit_power_dbm", float("-inf"), "a finite number"),
        ("path_loss_exponent", 0, "greater than 0"),
        ("reference_distance_m", 0, "greater than 0"),
        ("window_samples", 0, "a whole number between 1 and 10000"),
        ("window_samples", 2.5, "a whole number between 1 and 10000"),
        ("window_samples", 10**9, "a whole number between 1 and 10000"),  # gigabytes
        ("window_samples", 10**5000, "a whole number between 1 and 10000"),  # Python writes no such number
        ("max_movements", 0, "a whole number at least 1"),
        ("max_movements", 10**309, "a whole number at least 1"),
        ("los_phase", "random", "'common' or 'independent'"),
        ("los_phase", 3, "'common' or 'independent'"),
        ("continuity", "", "'independent' or 'continuous'"),
        ("spacing_choices_m", [], "greater than 0"),
        ("spacing_choices_m", 3.0, "greater than 0"),
        ("displacement_choices_m", "abc", "a finite number"),
        ("displacement_choices_m", [1.0] * 1001, "a list of 1 to 1000 numbers, each a finite number"),
    ],
    ids=lambda value: f"{value}"[:30] if not isinstance(value, int) else f"{value.bit_length()} bits",
)
def test_a_refusal_names_the_field_the_value_and_what_is_allowed(field: str, value: object, allowed: str) -> None:
    with pytest.raises(InputError) as refusal:
        paper_scenario(**{field: value})
    message = str(refusal.value)
    huge = isinstance(value, int) and value > 10**4300
    shown = "a number of too many digits" if huge else repr(tuple(value) if isinstance(value, list) else value)
    assert message.startswith(f"{field} = {shown if len(shown) <= 200 else f'{shown[:200]}...'} is refused: ")
    assert allowed in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("field", "entries", "bad"),
    [("spacing_choices_m", [1.0, 0.0], "0.0"), ("displacement_choices_m", [1.0, "north"], "'north'")],
)
def test_a_refused_entry_of_a_list_is_named_itself(field: str, entries: list[object], bad: str) -> None:
    with pytest.raises(InputError, match=f"^{field} = {bad} is refused: "):
        paper_scenario(**{field: entries})


def test_allowed_edges_are_allowed() -> None:
    changes = {"spatial_correlation": 0, "rician_k": 0, "doppler_spread_hz": 0, "window_samples": 1, "max_movements": 1}
    assert {name: getattr(paper_scenario(**changes), name) for name in changes} == changes
    assert paper_scenario(spatial_correlation=1).spatial_correlation == 1


def test_numbers_take_the_type_of_their_field() -> None:
    scenario = paper_scenario(sampling_hz=20, window_samples=25.0, spacing_choices_m=[1, 2])
    assert [type(scenario.sampling_hz), type(scenario.window_samples)] == [float, int]
    assert scenario.spacing_choices_m == (1.0, 2.0)
    assert paper_scenario(sampling_hz=20) == paper_scenario(sampling_hz=20.0)


def test_an_unknown_field_is_refused_with_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"^scenario has no field 'sampling_khz'; its fields are .*sampling_hz"):
        paper_scenario(sampling_khz=1)


positive = st.floats(1e-300, 1e300)
finite = st.floats(-1e300, 1e300)
fields = st.fixed_dictionaries(
    {},
    optional={
        "transmit_power_dbm": finite,
        "reference_distance_m": positive,
        "rician_k": st.floats(0, 1e300),
        "spatial_correlation": st.floats(0, 1),
        "window_samples": st.integers(1, 10_000),
        "sampling_hz": positive,
        "los_phase": st.sampled_from(["common", "independent"]),
        "continuity": st.sampled_from(["independent", "continuous"]),
        "spacing_choices_m": st.lists(positive, min_size=1, max_size=6),
        "displacement_choices_m": st.lists(finite, min_size=1, max_size=6),
    },
)


@settings(max_examples=50, deadline=None)
@given(changes=fields)
def test_a_scenario_comes_back_from_its_file_and_its_dict(
    changes: dict[str, Any], tmp_path_factory: pytest.TempPathFactory
) -> None:
    scenario = paper_scenario(**changes)
    path = tmp_path_factory.getbasetemp() / "scenario.toml"
    scenario.save_toml(path)
    assert Scenario.load_toml(path) == scenario
    assert Scenario.from_dict(json.loads(json.dumps(scenario.to_dict()))) == scenario


def test_a_file_may_hold_only_what_differs(tmp_path: Path) -> None:
    path = tmp_path / "scenario.toml"
    path.write_text("sampling_hz = 100\nspacing_choices_m = [1, 2]\n")
    assert Scenario.load_toml(path) == paper_scenario(sampling_hz=100, spacing_choices_m=[1, 2])


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"sampling_hz = ", "cannot read scenario"),
        (b"sampling_hz = 1\nsampling_hz = 2\n", "cannot read scenario"),
        (b"\xff\xfe", "cannot read scenario"),
        (b"rho = 0.5\n", "scenario has no field 'rho'"),
        (b"sampling_hz = '10'\n", "sampling_hz = '10' is refused"),
        (b"sampling_hz = nan\n", "sampling_hz = nan is refused"),
        (b"[sampling_hz]\nvalue = 10\n", "sampling_hz = {'value': 10} is refused"),
    ],
)
def test_a_broken_file_is_refused(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "scenario.toml"
    path.write_bytes(content)
    with pytest.raises(InputError) as refusal:
        Scenario.load_toml(path)
    assert str(refusal.value).startswith(says)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot read scenario .*nowhere\.toml"):
        Scenario.load_toml(tmp_path / "nowhere.toml")


@pytest.mark.skipif(os.name != "posix", reason="needs a POSIX file as a folder")
def test_an_unwritable_folder_is_refused_and_nothing_is_left(tmp_path: Path) -> None:
    """A file stands where the folder should be; permissions would not stop the superuser."""
    (tmp_path / "taken").write_text("")
    with pytest.raises(InputError, match=r"cannot write .*scenario\.toml"):
        paper_scenario().save_toml(tmp_path / "taken" / "scenario.toml")
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]


def test_a_refused_write_leaves_the_old_file_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "scenario.toml"
    paper_scenario(sampling_hz=20).save_toml(path)

    def disk_full(self: Path, text: str, encoding: str) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", disk_full)
    with pytest.raises(InputError, match="No space left on device"):
        paper_scenario(sampling_hz=100).save_toml(path)
    assert Scenario.load_toml(path).sampling_hz == 20
    assert [file.name for file in tmp_path.iterdir()] == ["scenario.toml"]


# What is shipped


def test_the_shipped_scenario_of_the_paper_is_table_one() -> None:
    assert load_scenario("paper") == paper_scenario()


def test_each_shipped_scenario_has_what_the_one_before_has_and_more() -> None:
    paper = paper_scenario()
    departs = [
        {(name, value) for name, value in vars(load_scenario(shipped)).items() if value != getattr(paper, name)}
        for shipped in NUMBERS_OF
    ]
    for (name, number), found in zip(NUMBERS_OF.items(), departs, strict=True):
        assert len(found) == number, name
    assert departs[1] < departs[2] < departs[3]


NUMBERS_OF = {"paper": 0, "flight": 14, "field": 20, "rough": 24}
"""Fields that depart from the paper's world."""


def test_a_scenario_nobody_knows_is_one_line() -> None:
    with pytest.raises(InputError, match=r"^no scenario 'fligth'; shipped are paper, flight, field, rough, any other"):
        load_scenario("fligth")
