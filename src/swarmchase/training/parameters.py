"""The parameters of all four networks as one flat vector, and their gradient as another.

One array is one copy to synchronise, one fused Adam step, and later one message. The networks' own parameters
are views of it.
"""

import copy

import torch

from ..errors import InputError
from ..networks.actor_critic import ActorCritic, SwarmNetworks, SymmetricNetworks, with_policy_scale
from ..networks.fading import FadingNetwork
from ..networks.gated import GatedNetwork
from ..networks.weights import FiledNetworks
from .rollout import Networks
from .settings import NetworkForm, TrainingSettings

ALIGNMENT = 16
"""Each parameter starts at a multiple of this many floats (64 bytes), so that vector loads stay aligned."""


class FlatNetworks:
    """Networks whose parameters and gradients are views of two flat float32 vectors."""

    def __init__(self, networks: Networks) -> None:
        self.networks = networks
        parameters = list(networks.parameters())
        starts, end = [], 0
        for parameter in parameters:
            starts.append(end)
            end += -(-parameter.numel() // ALIGNMENT) * ALIGNMENT
        device = parameters[0].device
        self.vector = torch.zeros(end, device=device)
        self.gradient = torch.zeros(end, device=device)
        for parameter, start in zip(parameters, starts, strict=True):
            part = slice(start, start + parameter.numel())
            self.vector[part] = parameter.detach().flatten()
            parameter.data = self.vector[part].view(parameter.shape)
            parameter.grad = self.gradient[part].view(parameter.shape)


def new_networks(settings: TrainingSettings, generator: torch.Generator | None = None) -> Networks:
    """Networks in the form that these settings train: drawn anew, or to be filled where there is no ``generator``."""
    if settings.form == "gated":
        return GatedNetwork(generator, settings.policy_scale)
    if settings.form == "fading":
        return FadingNetwork(generator)
    return _trained_form(SwarmNetworks(generator, settings.policy_scale), settings)


def continued_networks(settings: TrainingSettings, start: Networks) -> Networks:
    """Networks in the form that these settings train, which decide as ``start`` does.

    Raises:
        InputError: another form of network, or one network is to stand for x, y and z, and those of ``start`` are not
            the same.
    """
    if settings.form != form_of(start):
        raise InputError(
            f"these initial weights are of the form {form_of(start)}, and {settings.form} is to be trained"
        )
    if isinstance(start, GatedNetwork):
        return start.with_policy_scale(settings.policy_scale)
    if isinstance(start, FadingNetwork):
        return start
    assert isinstance(start, SwarmNetworks)
    if settings.symmetric:
        x, *others = (start.by_name[name].state_dict() for name in ("x", "y", "z"))
        if any(not torch.equal(x[name], other[name]) for other in others for name in x):
            raise InputError(
                "these initial weights have an x, a y and a z network of their own: train them with symmetric off"
            )
    return _trained_form(with_policy_scale(start, settings.policy_scale), settings)


def deployed(networks: Networks) -> FiledNetworks:
    """Networks as weights files hold them, which decide as the trained ones do, scales within their weights."""
    if isinstance(networks, GatedNetwork):
        return networks.with_policy_scale(1.0)
    if isinstance(networks, FadingNetwork):
        return copy.deepcopy(networks)
    assert isinstance(networks, SwarmNetworks | SymmetricNetworks)
    four = networks.separate() if isinstance(networks, SymmetricNetworks) else networks
    return with_policy_scale(four, 1.0)


def form_of(networks: Networks) -> NetworkForm:
    """``paper`` for the paper's four networks, or the name of another form."""
    if isinstance(networks, GatedNetwork):
        return "gated"
    return "fading" if isinstance(networks, FadingNetwork) else "paper"


def _trained_form(networks: SwarmNetworks, settings: TrainingSettings) -> Networks:
    trained = SymmetricNetworks(networks) if settings.symmetric else networks
    for module in trained.modules():
        if isinstance(module, ActorCritic):
            module.product_dtype = getattr(torch, settings.precision)
    return trained
