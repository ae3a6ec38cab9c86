"""The parameters of all four networks as one flat vector, and their gradient as another.

One array is one copy to synchronise, one fused Adam step, and later one message. The networks' own parameters
are views of it.
"""

import torch

from ..networks.protocol import HearingNetworks

ALIGNMENT = 16
"""Each parameter starts at a multiple of this many floats (64 bytes), so that vector loads stay aligned."""


class FlatNetworks:
    """Networks whose parameters and gradients are views of two flat float32 vectors."""

    def __init__(self, networks: HearingNetworks) -> None:
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
