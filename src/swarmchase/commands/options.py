"""Options that several commands share."""

import contextlib
import dataclasses
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import arg

from ..live.service.settings import OperatorSettings, ServiceSettings
from ..scenario import SHIPPED_SCENARIOS, Scenario, load_scenario
from .link_options import fields_from
from .terminal import CONSOLE, warn

if TYPE_CHECKING:
    from ..evaluation.blocks import Runner

ActionChoice = Literal["sampled", "greedy"]
"""As in ``controllers``, which is slow to import: it needs torch."""

CONTROLLERS = (
    "adaptive",
    "pursuit",
    "recurrent",
    "robust",
    "particle",
    "particle-unknown-power",
    "multilateration",
    "multilateration-unknown-power",
    "gradient",
    "paper",
    "paper-a3c",
    "random",
    "oracle",
    "oracle-intercept",
)
"""``controllers.controller_names()``, the one to use first, then those that listen best."""

DEFAULT_CONTROLLER = "adaptive"
"""Of every command unless another is asked for: it finds out what the channel and the receivers are like."""


def _controller_help(names: Sequence[str]) -> str:
    return f"{', '.join(names)}, or the path of a weights file; docs/controllers.md says which to choose."


ControllerName = Annotated[str, arg(help=_controller_help(CONTROLLERS))]
ListeningControllerName = Annotated[
    str, arg(help=_controller_help([name for name in CONTROLLERS if not name.startswith("oracle")]))
]
"""Of a live chase, where nobody can tell the oracle where the target is."""


if TYPE_CHECKING:

    @dataclass(frozen=True, kw_only=True)
    class _ScenarioFields:
        """Every field of ``Scenario`` by its name, None where it is not given."""

        def __init__(self, **fields: Any) -> None: ...

else:
    _ScenarioFields = dataclasses.make_dataclass(
        "_ScenarioFields",
        [
            (constant.name, Annotated[constant.type | None, arg(help=constant.metadata["help"])], None)
            for constant in dataclasses.fields(Scenario)
        ],
        frozen=True,
        kw_only=True,
    )


@dataclass(frozen=True, kw_only=True)
class _WorldOptions(_ScenarioFields):
    """The world of the chase: Table I of the paper, or another scenario, with these changes."""

    scenario: Annotated[
        str,
        arg(
            aliases=["--scenario-file"],
            help=f"{', '.join(SHIPPED_SCENARIOS)}, or a TOML file; what the file does not name is as in the paper.",
        ),
    ] = "paper"

    def _scenario(self, **changes: Any) -> Scenario:
        """The scenario of these options and changes; None changes nothing.

        Raises:
            InputError: a value or file that is refused.
        """
        given = {constant.name: getattr(self, constant.name) for constant in dataclasses.fields(Scenario)} | changes
        known = {name: value for name, value in given.items() if value is not None}
        return Scenario.from_dict(load_scenario(self.scenario).to_dict() | known)


@dataclass(frozen=True, kw_only=True)
class ScenarioOptions(_WorldOptions):
    """One world."""

    def world(self) -> Scenario:
        """The scenario these options describe.

        Raises:
            InputError: a value or file that is refused.
        """
        return self._scenario()


@dataclass(frozen=True, kw_only=True)
class SettingsOptions(_WorldOptions):
    """A world in several settings."""

    sampling_hz: tuple[float, ...] = ()
    """F, RSSI samples a second, one or several (the paper: 10, 20, 50, 100; default 10)."""
    spatial_correlation: tuple[float, ...] = ()
    """rho, correlation between trackers (the paper: 0.1, 0.5, 0.9; default 0.9); with several of both, every pair."""

    def scenarios(self) -> list[Scenario]:
        """Every pair of F and rho.

        Raises:
            InputError: a value or file that is refused.
        """
        return self._of_settings(self.sampling_hz, self.spatial_correlation)

    def _of_settings(self, frequencies_hz: Sequence[float], correlations: Sequence[float]) -> list[Scenario]:
        return [
            self._scenario(sampling_hz=sampling_hz, spatial_correlation=correlation)
            for correlation in correlations or (None,)
            for sampling_hz in frequencies_hz or (None,)
        ]


@dataclass(frozen=True, kw_only=True)
class ClusterOptions:
    """Where the work is done."""

    cluster: str | None = None
    """HOST:PORT of a Ray cluster's head, or local for one on this machine; default is processes here."""

    @contextlib.contextmanager
    def runner(self, batch_size: int | None = None) -> "Iterator[Runner | None]":
        """What runs blocks of chases on the cluster; None where processes here are to do it.

        Raises:
            InputError: the cluster cannot be used.
        """
        if self.cluster is None:
            yield None
            return
        from ..cluster.connection import connected
        from ..cluster.evaluation import on_cluster

        with connected(self.cluster, os.cpu_count() or 1, warn) as cluster:
            yield on_cluster(cluster, batch_size)


@dataclass(frozen=True, kw_only=True)
class ServiceOptions(OperatorSettings):
    """How the controller service runs a chase."""

    def settings(self) -> ServiceSettings:
        """The service's settings that these options say.

        Raises:
            InputError: a value that is refused.
        """
        return ServiceSettings(**fields_from(self, OperatorSettings))


def explain_choice(controller: str, scenario: Scenario) -> None:
    """Say which trained controller is used, and why, where the scenario's F and rho are not its own."""
    from ..controllers import chosen_weights

    chosen = chosen_weights(controller, scenario)
    explanation = None if chosen is None else chosen.explanation(scenario)
    if explanation is not None:
        CONSOLE.print(explanation, soft_wrap=True)
