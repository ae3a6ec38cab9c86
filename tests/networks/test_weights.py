"""Weights files: written and read back, and every bad file refused in one clear line; learned controllers' refusals."""

import json
import os
import pickle
import struct

import pytest
import torch
from safetensors.torch import load_file, save_file

from swarmchase.batch.streams import chase_keys
from swarmchase.controllers import controller_names, load_controller, require_controller
from swarmchase.controllers.learned import LearnedController
from swarmchase.errors import InputError
from swarmchase.networks.actor_critic import SwarmNetworks
from swarmchase.networks.fading import FadingNetwork
from swarmchase.networks.gated import GatedNetwork
from swarmchase.networks.paper import PaperForm
from swarmchase.networks.weights import load_weights, save_weights, shared_weights
from swarmchase.observation import Observation
from swarmchase.scenario import paper_scenario
from swarmchase.world.environment import Environment

CONFIGURATION = {"method": "by hand", "scenario": paper_scenario(sampling_hz=20).to_dict(), "list": [1, 2.5, None]}
HEAD = "by_name.x.policy_head.bias"


@pytest.fixture(scope="module")
def networks():
    return SwarmNetworks(torch.Generator().manual_seed(0))


@pytest.fixture
def path(tmp_path, networks):
    """A good weights file."""
    save_weights(tmp_path / "good.safetensors", networks, CONFIGURATION)
    return tmp_path / "good.safetensors"


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16])
def test_what_is_written_is_read(tmp_path, networks, dtype):
    path = tmp_path / "deep" / "er" / "it.safetensors"
    save_weights(path, networks, CONFIGURATION, dtype)
    assert load_file(path)[HEAD].dtype == dtype
    assert [file.name for file in path.parent.iterdir()] == ["it.safetensors"]
    found, configuration = load_weights(path)
    assert configuration == {"format": PaperForm.file_format, **CONFIGURATION}
    assert not found.training
    for name, tensor in networks.state_dict().items():
        assert found.state_dict()[name].dtype == torch.float32
        assert torch.equal(found.state_dict()[name], tensor.to(dtype).float()), name


def test_float16_is_half_the_file_and_hardly_another_controller(tmp_path, networks):
    save_weights(tmp_path / "32.safetensors", networks, {})
    save_weights(tmp_path / "16.safetensors", networks, {}, torch.float16)
    sizes = [(tmp_path / f"{bits}.safetensors").stat().st_size for bits in (16, 32)]
    assert sizes[0] == pytest.approx(sizes[1] / 2, rel=0.01)
    rssi_dbm = Environment(paper_scenario()).reset(chase_keys(0, 8)).rssi_dbm
    logits, _ = load_weights(tmp_path / "16.safetensors")[0](rssi_dbm)
    assert (logits - networks(rssi_dbm)[0]).abs().max() < 0.01


def test_writing_again_replaces_the_file(path):
    save_weights(path, SwarmNetworks(torch.Generator().manual_seed(1)), {"method": "again"})
    assert load_weights(path)[1]["method"] == "again"


def rewritten(path, change, document=None):
    """The good file with its tensors changed in place by ``change``."""
    tensors = load_file(path)
    change(tensors)
    save_file(
        tensors,
        path,
        {"swarmchase": json.dumps({"format": PaperForm.file_format, **CONFIGURATION, **(document or {})})},
    )


def one_bit_of_the_header(path):
    content = bytearray(path.read_bytes())
    content[20] ^= 0x80
    path.write_bytes(content)


def longer_header_than_the_file(path):
    path.write_bytes(struct.pack("<Q", 1 << 40) + path.read_bytes()[8:])


def pickled(path):
    """A pickle that leaves a trace when it is opened as one."""
    path.write_bytes(pickle.dumps(_Trace(str(path) + ".opened")))


class _Trace:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (self.path, "w")


BAD_FILES = {
    "missing": (lambda path: path.unlink(), "cannot read weights file .*good.safetensors: No such file"),
    "empty": (lambda path: path.write_bytes(b""), "damaged or was not written by swarmchase"),
    "truncated in its tensors": (lambda path: path.write_bytes(path.read_bytes()[:-1]), "damaged"),
    "truncated in its header": (lambda path: path.write_bytes(path.read_bytes()[:100]), "damaged"),
    "a bit of its header turned": (one_bit_of_the_header, "damaged"),
    "a header longer than the file": (longer_header_than_the_file, "damaged"),
    "text": (lambda path: path.write_text("not weights, but a text that is long enough"), "damaged"),
    "a pickle": (pickled, "damaged"),
    "a torch file": (lambda path: torch.save({"a": torch.zeros(2)}, path), "damaged"),
    "a folder": (lambda path: (path.unlink(), path.mkdir()), "cannot read weights file"),
    "safetensors of another making": (lambda path: save_file({"a": torch.zeros(2)}, path), "damaged or was not"),
    "a document that is no JSON": (
        lambda path: save_file(load_file(path), path, {"swarmchase": "{"}),
        "damaged or was not",
    ),
    "a document that is no object": (
        lambda path: save_file(load_file(path), path, {"swarmchase": "[]"}),
        "damaged or was not",
    ),
    "no format": (lambda path: save_file({}, path, {"swarmchase": "{}"}), "holds 'no known format', not"),
    "another format": (
        lambda path: rewritten(path, lambda tensors: None, {"format": "swarmchase-networks-99"}),
        "holds 'swarmchase-networks-99', not 'swarmchase-networks-1'",
    ),
    "an unknown way to choose actions": (
        lambda path: rewritten(path, lambda tensors: None, {"action_choice": "boldly"}),
        "says action_choice = 'boldly'; allowed is 'sampled' or 'greedy'",
    ),
    "a parameter missing": (
        lambda path: rewritten(path, lambda tensors: tensors.pop(HEAD)),
        f"{HEAD} is missing, needed is \\(5,\\)",
    ),
    "a parameter too many": (
        lambda path: rewritten(path, lambda tensors: tensors.update(more=torch.zeros(3))),
        "more is \\(3,\\), needed is no such parameter",
    ),
    "another shape": (
        lambda path: rewritten(path, lambda tensors: tensors.update({HEAD: torch.zeros(6)})),
        f"{HEAD} is \\(6,\\), needed is \\(5,\\)",
    ),
    "NaN inside": (
        lambda path: rewritten(path, lambda tensors: tensors[HEAD].__setitem__(2, float("nan"))),
        "numbers that are not finite",
    ),
    "whole numbers": (
        lambda path: rewritten(path, lambda tensors: tensors.update({HEAD: torch.zeros(5, dtype=torch.int64)})),
        "no floating-point numbers",
    ),
    "numbers of eight bits": (
        lambda path: rewritten(path, lambda tensors: tensors.update({HEAD: torch.zeros(5).to(torch.float8_e5m2)})),
        "as torch.float8_e5m2, in which swarmchase writes nothing",
    ),
    "complex numbers": (
        lambda path: rewritten(path, lambda tensors: tensors.update({HEAD: torch.zeros(5, dtype=torch.complex64)})),
        "as torch.complex64, in which swarmchase writes nothing",
    ),
    "numbers that no float32 can be": (
        lambda path: rewritten(
            path, lambda tensors: tensors.update({HEAD: torch.full((5,), 1e300, dtype=torch.float64)})
        ),
        "numbers that are not finite",
    ),
    "a deep document": (
        lambda path: save_file(load_file(path), path, {"swarmchase": '{"format": ' + "[" * 100_000}),
        "damaged or was not",
    ),
    "a format that is no text": (
        lambda path: rewritten(path, lambda tensors: None, {"format": ["swarmchase-networks-1"]}),
        r"holds \['swarmchase-networks-1'\], not",
    ),
    "a terabyte": (lambda path: os.truncate(path, 2**40), "has more than 67108864 bytes"),
    "infinity inside": (
        lambda path: rewritten(path, lambda tensors: tensors[HEAD].__setitem__(0, float("-inf"))),
        "numbers that are not finite",
    ),
}


@pytest.mark.parametrize(("spoil", "says"), BAD_FILES.values(), ids=BAD_FILES.keys())
def test_a_bad_file_is_refused_in_one_line(path, spoil, says):
    spoil(path)
    with pytest.raises(InputError, match=says) as refusal:
        load_controller(path, paper_scenario())
    assert "\n" not in str(refusal.value)
    assert str(path) in str(refusal.value)
    assert not path.with_name(path.name + ".opened").exists()


def test_weights_that_do_not_fit_float16_are_refused_when_read(tmp_path):
    networks = SwarmNetworks(torch.Generator().manual_seed(0))
    with torch.no_grad():
        networks.by_name["d"].policy_head.bias[0] = 1e6
    save_weights(tmp_path / "it.safetensors", networks, {}, torch.float16)
    with pytest.raises(InputError, match="not finite"):
        load_weights(tmp_path / "it.safetensors")


@pytest.mark.parametrize("name", ["papper", "", "no/such/folder"])
def test_an_unknown_name_is_answered_with_the_names_there_are(name):
    with pytest.raises(InputError, match=r"there are particle, .*random, oracle, .*path of a weights file") as refusal:
        load_controller(name, paper_scenario())
    assert repr(name) in str(refusal.value)


def test_a_folder_is_no_controller(tmp_path):
    with pytest.raises(InputError, match="no controller"):
        load_controller(tmp_path, paper_scenario())


def refusal_of(ask, *given):
    with pytest.raises(InputError) as refusal:
        ask(*given)
    return str(refusal.value)


@pytest.mark.parametrize("spoil", [spoil for spoil, _ in BAD_FILES.values()], ids=BAD_FILES.keys())
def test_a_check_refuses_a_bad_file_as_loading_does(path, spoil):
    spoil(path)
    assert refusal_of(require_controller, path, paper_scenario()) == refusal_of(load_controller, path, paper_scenario())


@pytest.mark.parametrize("network", [SwarmNetworks, GatedNetwork, FadingNetwork])
@pytest.mark.parametrize("world", [{}, {"window_samples": 40}, {"spacing_choices_m": (1.0, 2.0)}])
def test_a_check_refuses_a_scenario_as_loading_does(tmp_path, network, world):
    save_weights(tmp_path / "it.safetensors", network(torch.Generator().manual_seed(0)), {})
    for name in [tmp_path / "it.safetensors", tmp_path, "papper", *controller_names()]:
        scenario, refusals = paper_scenario(**world), []
        for ask in (require_controller, load_controller):
            try:
                ask(name, scenario)
            except InputError as refusal:
                refusals.append(str(refusal))
        assert refusals[:1] == refusals[1:], name


def test_a_check_builds_nothing_and_draws_nothing(path, monkeypatch):
    monkeypatch.setattr(SwarmNetworks, "load_state_dict", None)
    before = torch.random.get_rng_state()
    require_controller(path, paper_scenario())
    assert torch.equal(torch.random.get_rng_state(), before)


def test_networks_are_shared_by_what_their_file_holds(tmp_path, path):
    found, configuration = shared_weights(path)
    copy = tmp_path / "copy.safetensors"
    copy.write_bytes(path.read_bytes())
    assert shared_weights(copy)[0] is found
    save_weights(copy, SwarmNetworks(torch.Generator().manual_seed(1)), CONFIGURATION)
    other, _ = shared_weights(copy)
    expected, its_configuration = load_weights(copy)
    assert all(torch.equal(other.state_dict()[name], tensor) for name, tensor in expected.state_dict().items())
    assert configuration == its_configuration
    assert load_weights(path)[0] is not found  # training changes what it loads


def window(num_chases=2, samples=50, trackers=6):
    return torch.full((num_chases, samples, trackers), -60.0)


def decide(controller, rssi_dbm):
    position_m = torch.zeros(*rssi_dbm.shape, 3, dtype=torch.float64)
    return controller.decide(Observation(rssi_dbm, position_m), controller.begin(len(rssi_dbm), 0))[0]


def test_a_file_by_its_path_is_a_controller(path):
    scenario = paper_scenario()
    controller = load_controller(str(path), scenario)
    action = decide(controller, window(3))
    assert action.displacement_m.shape == (3, 3)
    assert set(action.spacing_m.tolist()) <= set(scenario.spacing_choices_m)


@pytest.mark.parametrize(
    ("in_file", "asked", "is_greedy"),
    [
        ({}, None, False),
        ({"action_choice": "greedy"}, None, True),
        ({"action_choice": "greedy"}, "sampled", False),
        ({"action_choice": "sampled"}, "greedy", True),
    ],
)
def test_actions_are_chosen_as_asked_or_else_as_the_file_says(tmp_path, networks, in_file, asked, is_greedy):
    save_weights(tmp_path / "it.safetensors", networks, in_file)
    controller = load_controller(tmp_path / "it.safetensors", paper_scenario(), asked)
    # The same window 64 times: one action for all is greedy, a sampled one differs somewhere.
    action = decide(controller, window(64))
    assert (len(action.displacement_m.unique(dim=0)) == 1) == is_greedy


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
def test_a_missing_sample_takes_the_mean_of_its_tracker_s_others(path, value):
    rssi_dbm = window() + torch.randn(2, 50, 6, generator=torch.Generator().manual_seed(1))
    filled_dbm = rssi_dbm.clone()
    rssi_dbm[1, 7, 2] = value
    filled_dbm[1, 7, 2] = (rssi_dbm[1, :7, 2].sum() + rssi_dbm[1, 8:, 2].sum()) / 49
    controller = load_controller(path, paper_scenario(), "greedy")
    found, expected = decide(controller, rssi_dbm), decide(controller, filled_dbm)
    assert torch.equal(found.displacement_m, expected.displacement_m)
    assert torch.equal(found.spacing_m, expected.spacing_m)


@pytest.mark.parametrize(("samples", "trackers"), [(49, 6), (51, 6), (50, 5), (1, 1)])
def test_a_window_of_another_size_is_refused(path, samples, trackers):
    with pytest.raises(InputError, match=rf"\({samples}, {trackers}\) is refused: .*needs 50 samples of 6 trackers"):
        decide(load_controller(path, paper_scenario()), window(2, samples, trackers))


@pytest.mark.parametrize(
    "world",
    [
        {"spacing_choices_m": (1.0, 2.0, 3.0, 4.0)},
        {"displacement_choices_m": (-4.0, -2.0, -1.0, 0.0, 1.0, 2.0, 4.0)},
        {"spacing_choices_m": (1.0,), "displacement_choices_m": (0.0,)},
    ],
)
def test_a_scenario_with_another_number_of_choices_is_refused(path, networks, world):
    for make in (
        lambda scenario: load_controller(path, scenario),
        lambda scenario: LearnedController(scenario, networks, "it"),
    ):
        with pytest.raises(InputError, match="decides between 5 spacings and displacements"):
            make(paper_scenario(**world))
