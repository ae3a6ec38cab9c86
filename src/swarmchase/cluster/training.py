"""A3C on a cluster: a global agent and N local agents, each an actor on some node; the books are kept here.

This process reads reports and looks after the actors. Gradients and parameters pass it by. What dies is started again,
wherever there is room: a local agent where it last reported, the global agent from the last checkpoint, and with it the
whole run.

    swarmchase train a3c --cluster 10.0.0.1:6379 --agents 100 --chases-per-agent 8 --folder runs/rack
"""

import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from ..batch.freed_memory import keep_freed_memory
from ..errors import WorkerDiedError
from ..networks.forms import new_networks
from ..scenario import Scenario
from ..training.agent import AgentSnapshot, LocalAgent
from ..training.evaluator import AuxiliaryEvaluation, Evaluator, measured
from ..training.global_agent import SharedParameters
from ..training.parameters import FlatNetworks
from ..training.run import TellStatus, TrainingResult, TrainingRun, next_evaluation, open_run
from ..training.settings import TrainingSettings
from .connection import Cluster, Tell, at_node, connected, first_line, own_error
from .global_actor import GlobalAgentActor, GlobalAgentLostError, GlobalNews
from .local_actor import AgentReport, LocalAgentActor, owned

POLL_S = 0.1
"""How often the global agent is asked for news."""
PIECE_S = 1.0
"""An agent reports after so long, and so much of its chases is lost where it is killed."""
REPORTS_PER_S = 100.0
"""Of all agents together, at most: the pieces are longer where there are more."""
NODES_S = 2.0
"""How often nodes are counted."""
GLOBAL_LIMIT_S = 60.0
"""The global agent is taken for lost when it has not answered for so long."""
START_LIMIT_S = 180.0
"""For the first local agent to find a CPU and start."""
SILENCE_LIMIT_S = 900.0
"""Between two reports of whatever agents: an update of many chases may take minutes."""
STOP_LIMIT_S = 60.0
"""For agents to end the piece that they are at."""
EVALUATION_LIMIT_S = 3_600.0
"""For the last evaluation."""
MOST_DEATHS = 3
"""Of one agent in a row, without a report between them."""
NEVER_RAN = "The actor never ran"
"""Ray's words, and its only sign, for an actor that it dropped before its process began. That is no
death: where no agent gets to run at all, their silence ends the training."""


def train_on_cluster(
    scenario: Scenario,
    settings: TrainingSettings,
    folder: Path,
    address: str,
    resume: bool = False,
    progress: TellStatus | None = None,
    tell: Tell | None = None,
) -> TrainingResult:
    """Train the four networks on the cluster at ``address`` (``connected``); what it makes lies in ``folder`` here.

    Ctrl-C stops it cleanly: the run is saved and can be resumed, on a cluster or without one.

    Raises:
        InputError: the cluster cannot be used, the folder cannot be written, holds a run and ``resume`` is false, or
            holds no run and it is true.
        WorkerDiedError: an agent raised an error, dies again and again, or nothing has been heard of any for too long.
    """
    tell = tell or (lambda _line: None)
    with (
        connected(address, settings.num_agents, tell) as cluster,
        open_run([scenario], settings, "cluster", folder, resume, progress) as run,
    ):
        _Supervisor(run, cluster, tell).train()
        return run.result()


@dataclass
class _Agent:
    """A local agent as this process knows it."""

    index: int
    snapshot: AgentSnapshot = field(repr=False)
    """Where it last reported."""
    actor: Any = None
    ready: Any = None
    """Done when its process is there."""
    work: Any = None
    """Its piece of work under way."""
    deaths: int = 0
    """Since its last report."""


class _Supervisor:
    """Starts the actors, enters what they report into the run's books, and starts again what dies."""

    def __init__(self, run: TrainingRun, cluster: Cluster, tell: Tell) -> None:
        self._run = run
        self._ray = cluster.ray
        self._cluster = cluster
        self._tell = tell
        self._settings = run.settings
        self._evaluator = Evaluator(run.scenarios, run.settings, run.schedule, run.folder.folder, run.best)
        self._agents = [_Agent(index, snapshot) for index, snapshot in enumerate(_snapshots(run))]
        self._piece_s = max(PIECE_S, run.settings.num_agents / REPORTS_PER_S)
        self._global_agent: Any = None
        self._incarnation = 0
        self._global_deaths = 0
        self._news: Any = None
        self._news_asked_s = 0.0
        self._finished = False
        self._last_checkpoint = -1
        self._evaluation: tuple[Any, Any] | None = None
        self._evaluation_deaths = 0
        self._next_evaluation = 0
        self._nodes = cluster.node_names()
        self._nodes_counted_s = self._heard_s = time.monotonic()
        self._nobody_heard = True

    def train(self) -> None:
        """Until the run ends, whatever dies on the way."""
        self._checkpoint(self._run.shared)  # where the run goes back to if the global agent dies before the first
        self._start_global_agent()
        for agent in self._agents:
            self._start(agent)
        while True:
            try:
                while not self._finished and self._run.stopped is None:
                    self._look_round()
                self._leave()
                return
            except GlobalAgentLostError as error:
                self._global_agent_died(error)

    def _look_round(self) -> None:
        self._read_reports(POLL_S)
        self._read_news()
        if int(self._run.shared.updates) >= self._last_checkpoint + self._settings.checkpoint_interval:
            self._checkpoint(self._asked(self._global_agent.snapshot))
            self._asked(self._global_agent.kept, self._last_checkpoint)
        self._evaluate()
        self._count_nodes()
        self._require_signs_of_life()
        self._run.show()

    def _start_global_agent(self) -> None:
        # Where the files are: without this node there is no run. It reserves no CPU: there is always room for it.
        actor = self._ray.remote(num_cpus=0, max_restarts=0)(GlobalAgentActor)
        here = at_node(self._cluster.home)
        self._global_agent = actor.options(scheduling_strategy=here).remote(self._settings, self._run.shared)
        self._incarnation += 1
        self._news, self._news_asked_s = None, time.monotonic()
        self._evaluation = None
        self._next_evaluation = next_evaluation(int(self._run.shared.updates), self._settings)

    def _start(self, agent: _Agent) -> None:
        actor = self._ray.remote(num_cpus=1, max_restarts=0)(LocalAgentActor)
        agent.actor = actor.options(scheduling_strategy="SPREAD").remote(
            self._run.scenarios[0], self._settings, agent.index
        )
        agent.ready = agent.actor.ready.remote()
        self._set_to_work(agent, agent.snapshot)

    def _set_to_work(self, agent: _Agent, start: AgentSnapshot | None = None) -> None:
        agent.work = agent.actor.work.remote(self._global_agent, self._incarnation, self._piece_s, start)

    def _read_reports(self, limit_s: float) -> None:
        """Enter the reports that are there, or the first that comes, and give their agents more to do."""
        agents = {agent.work: agent for agent in self._agents}
        for work in self._done(agents, limit_s):
            report = self._report(agents[work])
            if report is None:
                self._start(agents[work])
            else:
                self._enter(agents[work], report)
                self._set_to_work(agents[work])

    def _done(self, work: Collection[Any], limit_s: float) -> list[Any]:
        """What is done, at least one where that does not take longer than the limit."""
        first, _ = self._ray.wait(list(work), num_returns=1, timeout=limit_s)
        done: list[Any] = self._ray.wait(list(work), num_returns=len(work), timeout=0)[0] if first else []
        return done

    def _report(self, agent: _Agent) -> AgentReport | None:
        """What the agent reports; None if it has died."""
        try:
            report: AgentReport = self._ray.get(agent.work, timeout=GLOBAL_LIMIT_S)
        except self._ray.exceptions.RayTaskError as error:
            raise own_error(f"local agent {agent.index}", error) from error
        except self._ray.exceptions.RayError as error:
            self._agent_died(agent, error)
            return None
        if report.lost is not None:
            raise GlobalAgentLostError(report.lost)
        return report

    def _enter(self, agent: _Agent, report: AgentReport) -> None:
        agent.snapshot, agent.deaths = owned(report.snapshot), 0
        self._heard_s, self._nobody_heard = time.monotonic(), False
        self._run.environment_steps += report.environment_steps
        for chase in report.finished:
            self._run.chase_ended(chase)

    def _agent_died(self, agent: _Agent, error: Exception) -> None:
        agent.deaths += NEVER_RAN not in str(error)
        if agent.deaths >= MOST_DEATHS:
            raise WorkerDiedError(f"local agent {agent.index} died {MOST_DEATHS} times in a row:\n{error}")
        self._got_over(f"local agent {agent.index} is gone: {first_line(error)}")
        self._ray.kill(agent.actor)

    def _global_agent_died(self, error: GlobalAgentLostError) -> None:
        """A new one with the parameters of the last checkpoint; every agent goes back to where it was then."""
        self._require_signs_of_life()
        self._global_deaths += NEVER_RAN not in str(error)
        if self._global_deaths >= MOST_DEATHS:
            raise WorkerDiedError(f"the global agent died {MOST_DEATHS} times without a checkpoint between:\n{error}")
        self._ray.kill(self._global_agent)
        reached = int(self._run.shared.updates)
        point = self._run.go_back()
        self._finished = False
        self._last_checkpoint = int(point.parameters.updates)
        self._evaluator.best = point.best
        self._got_over(
            f"the global agent is gone after update {reached}: the run goes on from its checkpoint after update "
            f"{self._last_checkpoint}: {first_line(error)}"
        )
        self._start_global_agent()
        for agent, snapshot in zip(self._agents, point.agents, strict=True):
            agent.snapshot = snapshot
            self._set_to_work(agent, snapshot)

    def _got_over(self, what: str) -> None:
        self._run.fault(what)
        self._tell(what)

    def _read_news(self) -> None:
        """Ask the global agent how far it is, without waiting for the answer."""
        now_s = time.monotonic()
        if self._news is None:
            if now_s >= self._news_asked_s + POLL_S:
                self._news, self._news_asked_s = self._global_agent.news.remote(), now_s
            return
        if self._ray.wait([self._news], timeout=0)[0]:
            news, self._news = self._answer(self._news), None
            self._enter_news(news)
        elif now_s > self._news_asked_s + GLOBAL_LIMIT_S:
            raise GlobalAgentLostError(f"no news for {GLOBAL_LIMIT_S:g} s")

    def _enter_news(self, news: GlobalNews) -> None:
        for arrival in news.arrivals:
            self._run.gradient_applied(arrival.update, arrival.agent, arrival.updates_behind)
        self._run.shared.updates.fill_(news.updates)
        self._finished = news.updates >= self._settings.max_updates

    def _asked(self, method: Any, *arguments: Any) -> Any:
        """The global agent's answer."""
        return self._answer(method.remote(*arguments))

    def _answer(self, asked: Any) -> Any:
        try:
            return self._ray.get(asked, timeout=GLOBAL_LIMIT_S)
        except self._ray.exceptions.RayTaskError as error:
            raise own_error("the global agent", error) from error
        except self._ray.exceptions.RayError as error:
            raise GlobalAgentLostError(str(error)) from error

    def _checkpoint(self, parameters: SharedParameters) -> None:
        self._run.checkpoint(parameters, [agent.snapshot for agent in self._agents])
        if int(parameters.updates) > self._last_checkpoint:
            self._global_deaths = 0
        self._last_checkpoint = int(parameters.updates)

    def _evaluate(self) -> None:
        """Begin an evaluation when it is time, enter it when it has ended."""
        if self._evaluation is None and int(self._run.shared.updates) >= self._next_evaluation:
            self._next_evaluation = next_evaluation(int(self._run.shared.updates), self._settings)
            snapshot = self._global_agent.snapshot.remote()
            auxiliary_agent = self._ray.remote(num_cpus=0)(_evaluated)
            self._evaluation = snapshot, auxiliary_agent.remote(self._run.scenarios, self._settings, snapshot)
        if self._evaluation is not None and self._ray.wait([self._evaluation[1]], timeout=0)[0]:
            self._enter_evaluation(*self._evaluation)

    def _enter_evaluation(self, snapshot: Any, evaluation: Any) -> None:
        self._evaluation = None
        try:
            result: AuxiliaryEvaluation = self._ray.get(evaluation, timeout=EVALUATION_LIMIT_S)
        except self._ray.exceptions.GetTimeoutError as error:
            raise WorkerDiedError(f"the auxiliary agent has not ended within {EVALUATION_LIMIT_S:g} s") from error
        except self._ray.exceptions.RayTaskError as error:
            raise own_error("the auxiliary agent", error) from error
        except self._ray.exceptions.RayError as error:
            self._evaluation_deaths += 1
            if self._evaluation_deaths >= MOST_DEATHS:
                raise WorkerDiedError(f"the auxiliary agent died {MOST_DEATHS} times in a row:\n{error}") from error
            self._next_evaluation = int(self._run.shared.updates)
            self._got_over(f"the auxiliary agent is gone and evaluates again: {first_line(error)}")
            return
        self._evaluation_deaths = 0
        self._evaluator.keep(result, self._answer(snapshot))
        self._run.evaluated(result, self._evaluator.best, self._evaluator.meets_criterion(result))

    def _count_nodes(self) -> None:
        """A node that joins is looked at before it is trusted, one that leaves is mentioned."""
        if time.monotonic() < self._nodes_counted_s + NODES_S:
            return
        self._nodes_counted_s = time.monotonic()
        nodes = self._cluster.node_names()
        for node_id in self._nodes.keys() - nodes.keys():
            self._got_over(f"node {self._nodes[node_id]} is gone")
        joined = {node_id: name for node_id, name in nodes.items() if node_id not in self._nodes}
        for name in joined.values():
            self._got_over(f"node {name} has joined")
        self._cluster.require_same_software(joined)
        self._nodes = nodes

    def _require_signs_of_life(self) -> None:
        limit_s = START_LIMIT_S if self._nobody_heard else SILENCE_LIMIT_S
        if time.monotonic() > self._heard_s + limit_s:
            raise WorkerDiedError(f"no local agent has reported for {limit_s:g} s: {self._missing()}")

    def _missing(self) -> str:
        waiting = len(self._agents) - len(self._started())
        return f"{waiting} of {len(self._agents)} wait for a CPU; {self._cluster.shown_resources()}"

    def _started(self) -> list[_Agent]:
        """The agents whose processes are there."""
        there = set(
            self._ray.wait([agent.ready for agent in self._agents], num_returns=len(self._agents), timeout=0)[0]
        )
        return [agent for agent in self._agents if agent.ready in there]

    def _leave(self) -> None:
        """Let the agents end their pieces, make the last evaluation, save the run."""
        stop_by_s = time.monotonic() + STOP_LIMIT_S
        agents = {agent.work: agent for agent in self._started()}
        while agents and time.monotonic() < stop_by_s:
            for work in self._done(agents, POLL_S):
                agent = agents.pop(work)
                report = self._report(agent)
                if report is not None:
                    self._enter(agent, report)
        if self._news is not None:
            news, self._news = self._answer(self._news), None
            self._enter_news(news)
        self._enter_news(self._asked(self._global_agent.news))
        self._make_last_evaluation()
        parameters = self._asked(self._global_agent.snapshot)
        self._run.take(parameters)
        self._checkpoint(parameters)
        self._run.show()

    def _make_last_evaluation(self) -> None:
        """Wait for the evaluation of the finished run, unless the run is stopped."""
        stop_by_s = time.monotonic() + EVALUATION_LIMIT_S
        while self._run.stopped is None:
            self._evaluate()
            if self._evaluation is None and int(self._run.shared.updates) < self._next_evaluation:
                return
            if time.monotonic() > stop_by_s:
                raise WorkerDiedError(f"the last evaluation has not ended within {EVALUATION_LIMIT_S:g} s")
            self._run.show()
            time.sleep(POLL_S)


def _snapshots(run: TrainingRun) -> list[AgentSnapshot]:
    """Where every agent begins."""
    if run.point.agents:
        return list(run.point.agents)
    local = FlatNetworks(new_networks(run.settings))
    return [
        LocalAgent(run.scenarios[0], run.settings, index, local).snapshot() for index in range(run.settings.num_agents)
    ]


def _evaluated(
    scenarios: Sequence[Scenario], settings: TrainingSettings, parameters: SharedParameters
) -> AuxiliaryEvaluation:
    """The auxiliary agent: one evaluation on some node."""
    torch.set_num_threads(1)
    keep_freed_memory()
    return measured(scenarios, settings, parameters)
