"""The four actor-critic networks: spacing, x, y and z (Section III.A, Fig. 2, Table I).

Each takes a window of RSSI in dBm, [chase, 50, 6], through three LSTM layers of 128 and two ReLU layers of 128 to a
5-way policy and a value. The scaling of its input and of its value lives inside: it only re-parametrises the
first and the last layer, so the paper's architecture stands.
"""

import torch
from torch import nn

from ..batch.array_types import Float, Int, Tensor
from ..scenario import NUM_TRACKERS, Scenario
from .protocol import DecidingNetworks

NETWORK_NAMES = ("d", "x", "y", "z")
"""Superscript n of theta^n, in the order of every axis of length four in this package."""
NUM_CHOICES = 5
HIDDEN_FEATURES = 128
NUM_LSTM_LAYERS = 3

PAIR_DIFFERENCE_SCALE_DB = 3.0
LEVEL_CENTER_DBM = -60.0
LEVEL_SCALE_DB = 10.0
VALUE_SCALE_M = 10.0
"""The value head's unit: a value is a distance still to be won, tens of metres."""

PAPER_WINDOW_SAMPLES = 50
INITIAL_GATE_GAIN = 0.1
INITIAL_CANDIDATE_GAIN = (2.0, 4.0, 4.0)
INITIAL_OUTPUT_GATE_BIAS = 2.0


def input_map(first_axis: int) -> tuple[Tensor, Tensor]:
    """The fixed invertible map of the six RSSI columns: (weight [6, 6], bias [6]).

    Three differences of opposite trackers, the common level and two contrasts between pair sums. As plain dBm the
    1 dB between opposite trackers would drown in a level of -60 dBm. ``first_axis`` comes first in all of them and the
    other two follow in turn, so that the x, y and z networks see the same picture from their own axis.
    """
    axes = [(first_axis + turn) % 3 for turn in range(3)]
    plus = [torch.eye(NUM_TRACKERS)[2 * axis] for axis in axes]
    minus = [torch.eye(NUM_TRACKERS)[2 * axis + 1] for axis in axes]
    differences = [(up - down) / PAIR_DIFFERENCE_SCALE_DB for up, down in zip(plus, minus, strict=True)]
    own, second, third = ((up + down) / 2 for up, down in zip(plus, minus, strict=True))
    level = torch.full((NUM_TRACKERS,), 1 / NUM_TRACKERS) / LEVEL_SCALE_DB
    contrasts = [(own - (second + third) / 2) / PAIR_DIFFERENCE_SCALE_DB, (second - third) / PAIR_DIFFERENCE_SCALE_DB]
    weight = torch.stack([*differences, level, *contrasts])
    bias = torch.tensor([0, 0, 0, -LEVEL_CENTER_DBM / LEVEL_SCALE_DB, 0, 0])
    return weight, bias


class ActorCritic(nn.Module):
    """One network theta^n: a window of RSSI to a policy over five choices and a value in metres."""

    input_weight: Tensor
    input_bias: Tensor

    def __init__(self, first_axis: int) -> None:
        super().__init__()
        self.product_dtype = torch.float32
        weight, bias = input_map(first_axis)
        self.register_buffer("input_weight", weight, persistent=False)
        self.register_buffer("input_bias", bias, persistent=False)
        self.lstm = nn.LSTM(NUM_TRACKERS, HIDDEN_FEATURES, NUM_LSTM_LAYERS, batch_first=True)
        self.linear = nn.Sequential(
            nn.Linear(HIDDEN_FEATURES, HIDDEN_FEATURES),
            nn.ReLU(),
            nn.Linear(HIDDEN_FEATURES, HIDDEN_FEATURES),
            nn.ReLU(),
        )
        self.policy_head = nn.Linear(HIDDEN_FEATURES, NUM_CHOICES)
        self.value_head = nn.Linear(HIDDEN_FEATURES, 1)

    def forward(
        self, rssi_dbm: Float[Tensor, "chase sample 6"]
    ) -> tuple[Float[Tensor, "chase 5"], Float[Tensor, "chase"]]:
        """Policy logits and value in metres."""
        return self.heads(self.features(self.scaled(rssi_dbm)))

    def policy_logits(self, rssi_dbm: Float[Tensor, "chase sample 6"]) -> Float[Tensor, "chase 5"]:
        """The policy alone, for acting."""
        logits: Tensor = self.policy_head(self.features(self.scaled(rssi_dbm)))
        return logits

    def scaled(self, rssi_dbm: Float[Tensor, "chase sample 6"]) -> Float[Tensor, "chase sample 6"]:
        """The window through the input map."""
        return nn.functional.linear(rssi_dbm, self.input_weight, self.input_bias)

    def features(self, scaled: Float[Tensor, "row sample 6"]) -> Float[Tensor, "row 128"]:
        """What both heads see: the last hidden state after the two linear layers.

        The products of these layers may be bfloat16; the input map's never are: -60 dBm would be rounded to a
        quarter of a decibel.
        """
        with torch.autocast(scaled.device.type, self.product_dtype, enabled=self.product_dtype != torch.float32):
            hidden, _ = self.lstm(scaled)
            features: Tensor = self.linear(hidden[:, -1])
        return features.to(scaled.dtype)

    def heads(self, features: Float[Tensor, "row 128"]) -> tuple[Float[Tensor, "row 5"], Float[Tensor, "row"]]:
        """Policy logits and value in metres of these features."""
        return self.policy_head(features), VALUE_SCALE_M * self.value_head(features)[:, 0]


class WindowNetworks(DecidingNetworks):
    """Networks that decide from the current window alone. Their memory of a chase is a vector of length 0."""

    form = "paper"
    memory_features = 0
    batch_multiple = 8

    def policy_logits(self, rssi_dbm: Float[Tensor, "chase sample 6"]) -> Float[Tensor, "chase 4 5"]:
        """The policies alone, for acting."""
        raise NotImplementedError

    def begin(self, _scenario: Scenario, num_chases: int) -> Float[Tensor, "chase 0"]:
        """The memory before the first window."""
        return torch.zeros(num_chases, 0)

    def decide(
        self,
        rssi_dbm: Float[Tensor, "chase sample 6"],
        _tracker_position_m: Float[Tensor, "chase 6 3"],
        memory: Float[Tensor, "chase 0"],
    ) -> tuple[Float[Tensor, "chase 4 5"], Float[Tensor, "chase 0"]]:
        """Logits of the four policies; missing samples are filled (``filled_window_dbm``)."""
        return self.policy_logits(filled_window_dbm(rssi_dbm)), memory

    def decide_in_sequence(
        self,
        rssi_dbm: Float[Tensor, "step chase sample 6"],
        _tracker_position_m: Float[Tensor, "step chase 6 3"],
        _memory: Float[Tensor, "chase 0"],
    ) -> Float[Tensor, "step chase 4 5"]:
        """Logits of the four policies at every step of a rollout."""
        logits = self.policy_logits(filled_window_dbm(rssi_dbm.flatten(0, 1)))
        return logits.view(*rssi_dbm.shape[:2], *logits.shape[1:])


def filled_window_dbm(rssi_dbm: Float[Tensor, "chase sample 6"]) -> Float[Tensor, "chase sample 6"]:
    """A missing sample takes the mean of its tracker's others, a silent tracker the mean of the others, and a window of
    nothing ``LEVEL_CENTER_DBM``: the networks were never shown a gap."""
    valid = rssi_dbm.isfinite()
    if valid.all():
        return rssi_dbm.contiguous()
    mean_dbm = torch.where(valid, rssi_dbm, torch.nan).nanmean(dim=1, keepdim=True)
    mean_dbm = torch.where(mean_dbm.isfinite(), mean_dbm, mean_dbm.nanmean(dim=2, keepdim=True))
    return torch.where(valid, rssi_dbm, mean_dbm.nan_to_num(LEVEL_CENTER_DBM)).contiguous()


class SwarmNetworks(WindowNetworks):
    """theta^d, theta^x, theta^y and theta^z, four networks that share nothing."""

    def __init__(self, generator: torch.Generator | None = None, policy_scale: float = 1.0) -> None:
        """``generator`` draws the initial weights; without it they are left for a file to fill.

        Logits are the policy heads' outputs times ``policy_scale``, as values are the value heads' times
        ``VALUE_SCALE_M``; ``with_policy_scale`` moves it into the weights.
        """
        super().__init__()
        self.policy_scale = policy_scale
        with torch.random.fork_rng(devices=[]):
            self.by_name = nn.ModuleDict(
                {name: ActorCritic(first_axis=max(0, axis - 1)) for axis, name in enumerate(NETWORK_NAMES)}
            )
        if generator is not None:
            initialise(self, generator)

    def forward(
        self, rssi_dbm: Float[Tensor, "chase sample 6"]
    ) -> tuple[Float[Tensor, "chase 4 5"], Float[Tensor, "chase 4"]]:
        """Policy logits and values in metres of the four networks, in the order d, x, y, z."""
        logits, values = zip(*(network(rssi_dbm) for network in self.by_name.values()), strict=True)
        return self.policy_scale * torch.stack(logits, dim=1), torch.stack(values, dim=1)

    def policy_logits(self, rssi_dbm: Float[Tensor, "chase sample 6"]) -> Float[Tensor, "chase 4 5"]:
        """The policies alone, for acting."""
        networks = (network for network in self.by_name.values() if isinstance(network, ActorCritic))
        return self.policy_scale * torch.stack([network.policy_logits(rssi_dbm) for network in networks], dim=1)


class SymmetricNetworks(WindowNetworks):
    """theta^d, and one network in the place of theta^x, theta^y and theta^z, which hears the window from each axis.

    The three axes are images of one another, so one network may learn from all three: three times the data.
    ``separate`` gives the paper's four networks that decide as this does.
    """

    view_weight: Tensor
    view_bias: Tensor

    def __init__(self, networks: SwarmNetworks) -> None:
        """Begins as the x network of ``networks``, with their spacing network and policy scale."""
        super().__init__()
        self.policy_scale = networks.policy_scale
        self.spacing, self.axis = (_of_name(networks, name) for name in ("d", "x"))
        maps = [input_map(axis) for axis in range(3)]
        self.register_buffer("view_weight", torch.cat([weight for weight, _ in maps]), persistent=False)
        self.register_buffer("view_bias", torch.cat([bias for _, bias in maps]), persistent=False)

    def forward(
        self, rssi_dbm: Float[Tensor, "chase sample 6"]
    ) -> tuple[Float[Tensor, "chase 4 5"], Float[Tensor, "chase 4"]]:
        """As ``SwarmNetworks.forward``."""
        spacing_logits, spacing_value = self.spacing(rssi_dbm)
        axis_logits, axis_value = self.axis.heads(self._axis_features(rssi_dbm))
        logits = torch.cat([spacing_logits[:, None], _by_chase(axis_logits)], dim=1)
        return self.policy_scale * logits, torch.cat([spacing_value[:, None], _by_chase(axis_value)], dim=1)

    def policy_logits(self, rssi_dbm: Float[Tensor, "chase sample 6"]) -> Float[Tensor, "chase 4 5"]:
        """As ``SwarmNetworks.policy_logits``."""
        axis_logits = _by_chase(self.axis.policy_head(self._axis_features(rssi_dbm)))
        return self.policy_scale * torch.cat([self.spacing.policy_logits(rssi_dbm)[:, None], axis_logits], dim=1)

    def _axis_features(self, rssi_dbm: Float[Tensor, "chase sample 6"]) -> Float[Tensor, "row 128"]:
        """Of the x axis for every chase, then of y, then of z."""
        views = nn.functional.linear(rssi_dbm, self.view_weight, self.view_bias)
        return self.axis.features(views.view(*rssi_dbm.shape[:2], 3, -1).movedim(2, 0).flatten(0, 1).contiguous())

    def separate(self) -> SwarmNetworks:
        """The four networks of the paper with these weights."""
        networks = SwarmNetworks(policy_scale=self.policy_scale)
        _of_name(networks, "d").load_state_dict(self.spacing.state_dict())
        for name in ("x", "y", "z"):
            _of_name(networks, name).load_state_dict(self.axis.state_dict())
        return networks


def _by_chase(rows: Float[Tensor, "row ..."]) -> Float[Tensor, "chase 3 ..."]:
    """Rows of the x axis for every chase, then of y and of z, as one axis of three."""
    return rows.reshape(3, -1, *rows.shape[1:]).transpose(0, 1)


def _of_name(networks: SwarmNetworks, name: str) -> ActorCritic:
    network = networks.by_name[name]
    assert isinstance(network, ActorCritic)
    return network


def with_policy_scale(networks: SwarmNetworks, policy_scale: float) -> SwarmNetworks:
    """Networks with the same policies and another ``policy_scale``; the policy heads' weights make up for it."""
    scaled = SwarmNetworks(policy_scale=policy_scale)
    scaled.load_state_dict(networks.state_dict())
    with torch.no_grad():
        for name in NETWORK_NAMES:
            head = _of_name(scaled, name).policy_head
            for parameter in (head.weight, head.bias):
                parameter.mul_(networks.policy_scale / policy_scale)
    return scaled


def initialise(networks: SwarmNetworks, generator: torch.Generator) -> None:
    """Draw all weights anew. The paper says nothing of them; what matters is that a new network hears its input.

    With the usual uniform weights the last features of the three layers vary by 0.0002 from one direction of the target
    to another, and training first has to make them vary at all. Here each LSTM begins as an average over the window:
    forget biases log T' with T' uniform on (1, L - 1) samples and input biases the opposite (Tallec and Ollivier
    2018, "Can recurrent neural networks warp time?"), gates nearly open-loop, candidates with a gain that makes up for
    what the gates take. Features then vary by 0.2.
    """
    with torch.no_grad():
        for network in networks.by_name.values():
            assert isinstance(network, ActorCritic)
            for layer in range(NUM_LSTM_LAYERS):
                _initialise_lstm_layer(network.lstm, layer, generator)
            for linear in (network.linear[0], network.linear[2]):
                assert isinstance(linear, nn.Linear)
                linear.weight.normal_(0, (2 / HIDDEN_FEATURES) ** 0.5, generator=generator)
                linear.bias.zero_()
            for head in (network.policy_head, network.value_head):
                head.weight.uniform_(-(HIDDEN_FEATURES**-0.5), HIDDEN_FEATURES**-0.5, generator=generator)
                head.bias.zero_()


def _initialise_lstm_layer(lstm: nn.LSTM, layer: int, generator: torch.Generator) -> None:
    input_weight, recurrent_weight = getattr(lstm, f"weight_ih_l{layer}"), getattr(lstm, f"weight_hh_l{layer}")
    bias, second_bias = getattr(lstm, f"bias_ih_l{layer}"), getattr(lstm, f"bias_hh_l{layer}")
    input_gate, forget_gate, candidate, output_gate = (
        slice(k * HIDDEN_FEATURES, (k + 1) * HIDDEN_FEATURES) for k in range(4)
    )
    input_weight.normal_(0, INITIAL_GATE_GAIN * input_weight.shape[1] ** -0.5, generator=generator)
    input_weight[candidate] *= INITIAL_CANDIDATE_GAIN[layer] / INITIAL_GATE_GAIN
    recurrent_weight.normal_(0, INITIAL_GATE_GAIN * HIDDEN_FEATURES**-0.5, generator=generator)
    second_bias.zero_()
    bias.zero_()
    bias[forget_gate].uniform_(1, PAPER_WINDOW_SAMPLES - 1, generator=generator).log_()
    bias[input_gate] = -bias[forget_gate]
    bias[output_gate] = INITIAL_OUTPUT_GATE_BIAS


def greedy_choice(logits: Float[Tensor, "... 5"]) -> Int[Tensor, "..."]:
    """The most likely choice of each policy."""
    return logits.argmax(dim=-1)


def sampled_choice(logits: Float[Tensor, "chase 4 5"], uniform: Float[Tensor, "chase 4"]) -> Int[Tensor, "chase 4"]:
    """A choice drawn from each policy by inverting its cumulative distribution at ``uniform``."""
    cumulative = logits.double().softmax(dim=-1).cumsum(dim=-1)
    return (cumulative[..., :-1] <= uniform[..., None]).sum(dim=-1)
