"""The parameters of all four networks as one flat vector, and their gradient as another.

One array is one copy to synchronise, one fused Adam step, and later one message. The networks' own parameters
are views of it.
"""

import torch

from ..errors import InputError
from ..networks import ActorCritic, Networks, SwarmNetworks, SymmetricNetworks, with_policy_scale
from .settings import TrainingSettings

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
    return _trained_form(SwarmNetworks(generator, settings.policy_scale), settings)


def continued_networks(settings: TrainingSettings, start: SwarmNetworks) -> Networks:
    """Networks in the form that these settings train, which decide as ``start`` does.

    Raises:
        InputError: one network is to stand for x, y and z, and those of ``start`` are not the same.
    """
    if settings.symmetric:
        x, *others = (start.by_name[name].state_dict() for name in ("x", "y", "z"))
        if any(not torch.equal(x[name], other[name]) for other in others for name in x):
            raise InputError(
                "these initial weights have an x, a y and a z network of their own: train them with symmetric off"
            )
    return _trained_form(with_policy_scale(start, settings.policy_scale), settings)


def deployed(networks: Networks) -> SwarmNetworks:
    """The paper's four networks that decide as the trained ones do, scales within their weights."""
    four = networks.separate() if isinstance(networks, SymmetricNetworks) else networks
    return with_policy_scale(four, 1.0)


def _trained_form(networks: SwarmNetworks, settings: TrainingSettings) -> Networks:
    trained = SymmetricNetworks(networks) if settings.symmetric else networks
    for module in trained.modules():
        if isinstance(module, ActorCritic):
            module.product_dtype = getattr(torch, settings.precision)
    return trained
