"""Networks as ONNX files decide in onnxruntime as they do in torch."""

import json
import math
from pathlib import Path

import onnxruntime
import pytest
import torch

from swarmchase.cli import main
from swarmchase.controllers import learned_networks, load_controller, weights_sha256
from swarmchase.controllers.learned import LearnedController
from swarmchase.controllers.shipped import ShippedWeights, shipped_families
from swarmchase.networks.actor_critic import WindowNetworks, filled_window_dbm, greedy_choice
from swarmchase.networks.onnx_file import save_onnx
from swarmchase.networks.protocol import DecidingNetworks, ExpectingNetwork, HearingNetworks
from swarmchase.networks.pursuit import PursuitNetwork
from swarmchase.networks.windows import HeardWindows, WindowsNetwork
from swarmchase.scenario import Scenario, paper_scenario
from swarmchase.world.environment import Environment

ROOT = Path(__file__).parents[2]
CLOSE = 1e-4
FILLED_CLOSE = 5e-4
"""Where levels are means, which torch and onnxruntime round differently in the last bit."""


def session_of(path: Path) -> onnxruntime.InferenceSession:
    return onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])


def run(session: onnxruntime.InferenceSession, **inputs: torch.Tensor) -> list[torch.Tensor]:
    return [torch.tensor(one) for one in session.run(None, {name: one.numpy() for name, one in inputs.items()})]


def own_scenario(weights: ShippedWeights) -> Scenario:
    sampling_hz, spatial_correlation = weights.setting or (50.0, 0.5)
    return paper_scenario(sampling_hz=sampling_hz, spatial_correlation=spatial_correlation)


def heard(scenario: Scenario, num_chases: int) -> torch.Tensor:
    """First windows as the environment gives them."""
    observation = Environment(scenario).reset([(1, chase) for chase in range(num_chases)]).observation()
    return observation.rssi_dbm.float()


def with_gaps(window_dbm: torch.Tensor) -> torch.Tensor:
    """A third missing, a silent tracker, a window with one sample, and one with none."""
    gappy = window_dbm.clone()
    gappy[torch.rand(gappy.shape, generator=torch.Generator().manual_seed(1)) < 0.3] = math.nan
    gappy[1, :, 2] = math.nan
    gappy[2] = math.nan
    gappy[3, 1:] = math.nan
    return gappy


def law_of(networks: WindowsNetwork, window_dbm: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """Of all windows of one chase."""
    read = networks.heard(window_dbm)
    counts = window_dbm.isfinite().flatten(1).any(dim=1)
    law = networks.law(HeardWindows(read.own[None], read.together[None]), counts[None])
    return law.mean_db[0], law.apart_db[0], law.together_db[0]


def by_torch(networks: HearingNetworks, inputs: dict[str, torch.Tensor]) -> tuple[torch.Tensor, ...]:
    """What networks of each form say to the inputs of their file."""
    if isinstance(networks, WindowNetworks):
        return (networks.policy_logits(filled_window_dbm(inputs["rssi_dbm"])),)
    if isinstance(networks, ExpectingNetwork):
        return (networks(inputs["rssi_dbm"], inputs["memory"]),)
    if isinstance(networks, WindowsNetwork):
        return law_of(networks, inputs["rssi_dbm"])
    if isinstance(networks, PursuitNetwork):
        reading, memory = networks(*(inputs[name] for name in ("rssi_dbm", "tracker_position_m", "center_m", "memory")))
        return reading.command, reading.way_m, reading.velocity_mps, reading.spread_m, memory
    assert isinstance(networks, DecidingNetworks)
    logits, memory = networks.decide(**inputs)
    is_heard = inputs["rssi_dbm"].isfinite().flatten(1).any(dim=1, keepdim=True)
    return logits, torch.where(is_heard, memory, inputs["memory"])


@pytest.mark.parametrize("family", shipped_families())
def test_every_learned_controller_says_the_same_in_onnxruntime(family: str, tmp_path: Path) -> None:
    files = shipped_families()[family]
    for weights in {files[0].name: files[0], files[-1].name: files[-1]}.values():  # others differ in numbers alone
        scenario = own_scenario(weights)
        networks, _ = learned_networks(weights.path, scenario)
        told = save_onnx(tmp_path / "networks.onnx", networks, scenario, {})
        session = session_of(tmp_path / "networks.onnx")
        whole_dbm = heard(scenario, 16)
        for window_dbm in (whole_dbm, with_gaps(whole_dbm)):
            place_m = 5 * torch.randn(16, 6, 3, generator=torch.Generator().manual_seed(2))
            offered = {
                "rssi_dbm": window_dbm,
                "tracker_position_m": place_m,
                "center_m": place_m.mean(dim=1),
                "memory": networks.begin(scenario, 16),
            }
            inputs = {name: offered[name] for name in told["inputs"]}
            with torch.inference_mode():
                expected = by_torch(networks, inputs)
            fills_gaps = isinstance(networks, WindowNetworks) and window_dbm is not whole_dbm
            for found, one in zip(run(session, **inputs), expected, strict=True):
                close = (FILLED_CLOSE if fills_gaps else CLOSE) * max(1.0, float(one.abs().max()))
                assert (found - one).abs().max() < close, weights.name


def test_the_memory_goes_from_window_to_window(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Chases that the controller plays itself, heard by the file beside it."""
    scenario = paper_scenario(sampling_hz=20.0, spatial_correlation=0.5)
    path = tmp_path / "robust.onnx"
    main(f"export {path} --controller robust --sampling-hz 20 --spatial-correlation 0.5 --json".split())
    told = json.loads(capsys.readouterr().out)
    session = session_of(path)
    assert json.loads(session.get_modelmeta().custom_metadata_map["swarmchase"]).items() <= told.items()
    assert told["weights_sha256"] == weights_sha256("robust", scenario)
    assert (told["action_choice"], Scenario.from_dict(told["scenario"])) == ("greedy", scenario)
    controller, environment = load_controller("robust", scenario), Environment(scenario)
    assert isinstance(controller, LearnedController)
    state = environment.reset([(1, chase) for chase in range(16)])
    own = controller.begin(16, seed=1)
    memory = torch.tensor([told["initial_memory"]]).expand(16, -1).contiguous()
    deaf = 5
    for number in range(8):
        observation = state.observation()
        if number in (2, 3):
            observation.rssi_dbm[deaf] = math.nan
        place_m = observation.tracker_position_m.mean(dim=1).float()
        rssi_dbm = observation.rssi_dbm.float()
        logits, memory = run(session, rssi_dbm=rssi_dbm, tracker_position_m=place_m, memory=memory)
        action, own = controller.decide(observation, own)
        assert (logits - own.logits).abs().max() < CLOSE
        assert torch.equal(greedy_choice(logits), greedy_choice(own.logits))
        assert (memory - own.network_memory).abs().max() < CLOSE
        state, _ = environment.step(state, action)


def test_the_documents_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (ROOT / "docs" / "onnx.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    command = next(line for line in text.splitlines() if line.startswith("    swarmchase export"))
    main(command.split()[1:])
    names: dict[str, object] = {}
    exec(compile(text.partition("```python\n")[2].partition("```")[0], "docs/onnx.md", "exec"), names)
    assert names["spacing"] in range(5)
    session = session_of(tmp_path / "robust.onnx")
    shapes = {one.name: one.shape for one in (*session.get_inputs(), *session.get_outputs())}
    for name, shape in shapes.items():
        assert f"`{name}` [{', '.join(map(str, shape))}]" in text
    assert shapes["logits"] == ["chase", 4, 5]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("export here.onnx --controller particle", "particle has no networks in this scenario"),
        ("export here.onnx --scenario flight", "adaptive has no networks in this scenario"),
        ("export there.onnx --controller recurrent", "there.onnx: it exists already"),
        ("export here.onnx --controller recurrent --window-samples 20", "recurrent needs windows of 50 samples"),
    ],
)
def test_what_cannot_be_exported_is_one_line(
    words: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("there.onnx").touch()
    with pytest.raises(SystemExit) as ended:
        main(words.split(" "))
    assert ended.value.code == 2
    assert says in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["there.onnx"]
