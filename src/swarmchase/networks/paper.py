"""The paper's form: four networks in a file, which may be trained with one network in the place of x, y and z."""

import torch

from ..errors import InputError
from .actor_critic import ActorCritic, SwarmNetworks, SymmetricNetworks, WindowNetworks, with_policy_scale
from .protocol import Form, FormSettings


class PaperForm(Form[SwarmNetworks, WindowNetworks]):
    """``SwarmNetworks`` in files; ``SymmetricNetworks`` where a training is symmetric."""

    name = WindowNetworks.form
    file_format = "swarmchase-networks-1"
    objectives = frozenset({"actor_critic", "ppo", "all_actions", "counterfactual"})
    why_no_other_objective = "the objective fading is for the form fading alone"
    own_settings = frozenset({"symmetric", "mirrored", "precision"})
    window_samples = None
    filed = SwarmNetworks

    def new(self, settings: FormSettings, generator: torch.Generator | None) -> WindowNetworks:
        """As ``Form.new``."""
        return _as_trained(SwarmNetworks(generator, settings.policy_scale), settings)

    def continued(self, settings: FormSettings, start: SwarmNetworks) -> WindowNetworks:
        """As ``Form.continued``.

        Raises:
            InputError: one network is to stand for x, y and z, and those of ``start`` are not the same.
        """
        if settings.symmetric:
            x, *others = (start.by_name[name].state_dict() for name in ("x", "y", "z"))
            if any(not torch.equal(x[name], other[name]) for other in others for name in x):
                raise InputError(
                    "these initial weights have an x, a y and a z network of their own: train them with symmetric off"
                )
        return _as_trained(with_policy_scale(start, settings.policy_scale), settings)

    def deployed(self, trained: WindowNetworks) -> SwarmNetworks:
        """As ``Form.deployed``."""
        four = trained.separate() if isinstance(trained, SymmetricNetworks) else trained
        assert isinstance(four, SwarmNetworks)
        return with_policy_scale(four, 1.0)


def _as_trained(networks: SwarmNetworks, settings: FormSettings) -> WindowNetworks:
    trained = SymmetricNetworks(networks) if settings.symmetric else networks
    for module in trained.modules():
        if isinstance(module, ActorCritic):
            module.product_dtype = getattr(torch, settings.precision)
    return trained
