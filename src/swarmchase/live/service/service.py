"""The controller service: one chase with real trackers.

    IDLE -> CONNECTING -> SAMPLING <-> MOVING -> REACHED, LOST or ABORTED; HOLDING in between while something is wrong

Where the scenario has trackers listen while they fly, PURSUING, FOLLOWING and SEARCHING stand in the place of SAMPLING
and MOVING (``course``).

``step`` is called again and again, at 20 Hz say, and never blocks: hear what has come in, find out who can be
commanded, do what the state asks for, stream the set-points. The set-points are the proof of life: where no step is
made, trackers hold by themselves. The controller decides inside ``step``, and it is the very one that evaluation runs.

Not thread-safe: the operator's words (``start``, ``hold``, ``resume``, ``declare_reached``, ``abort``) come between
steps.
"""

import math
from collections.abc import Callable

import numpy as np
import torch

from ...controllers.belief import Belief, Believing
from ...controllers.condition import Condition
from ...controllers.explanation import Explaining, Explanation
from ...controllers.protocol import Controller
from ...errors import InputError
from ...observation import Observation
from ...scenario import NUM_TRACKERS, Scenario
from ..clock import Clock
from ..link.messages import SetPoint
from ..link.protocol import ControllerLink
from .chase_state import (
    IN_FLIGHT,
    LED,
    NOT_ONE_TRANSMITTER,
    UNDER_WAY,
    ChaseState,
    Decision,
    PreflightCheck,
    Snapshot,
    Transition,
)
from .course import FlightCourse
from .nearness import NearnessJudge
from .pace import StopAndListen, Window
from .preflight import beyond_the_fence, failing, in_words, preflight
from .pursuit import ListenInFlight
from .safety import Move, SafetyFilter, SafetyLimits
from .sample_window import Point
from .settings import ServiceSettings
from .swarm import Swarm, metres

Recorder = Callable[[Transition | Decision], None]

ABORT_S = 1.0
"""So long trackers are told to hold after ``abort``: one set-point alone may get lost."""
DEAF_WINDOWS = 3
"""After so many windows in a row in which the controller heard nothing, something is wrong."""


class ControllerService:
    """Runs chase ``chase`` of run ``seed`` through a link.

    Args:
        recorder: Is given every transition and decision; its failures are counted, not raised.
        epoch: Larger than that of any controller that has spoken to these trackers before.

    Raises:
        InputError: an epoch that cannot be, or a controller and a scenario that no vehicles can fly together.
    """

    def __init__(
        self,
        scenario: Scenario,
        controller: Controller,
        link: ControllerLink,
        clock: Clock,
        limits: SafetyLimits,
        recorder: Recorder,
        epoch: int,
        seed: int = 0,
        chase: int = 0,
        settings: ServiceSettings | None = None,
    ) -> None:
        SetPoint(0, 0, epoch, (0.0, 0.0, 0.0))
        self._scenario, self._controller, self._link, self._clock = scenario, controller, link, clock
        self._recorder, self._epoch = recorder, epoch
        self._settings = settings or ServiceSettings()
        self._filter = SafetyFilter(limits, scenario.spacing_choices_m)
        self._swarm = Swarm(scenario, limits)
        self._pace: StopAndListen | ListenInFlight
        self._judge: NearnessJudge | FlightCourse
        require_judged(scenario, controller, self._settings)
        if scenario.pace == "stop_and_listen":
            self._pace = StopAndListen(scenario, self._settings, self._swarm, limits.highest_speed_mps)
            self._judge = NearnessJudge(scenario, self._settings.reached_windows, self._settings.minimum_trackers)
        else:
            self._pace = ListenInFlight(scenario, self._swarm, limits)
            self._judge = FlightCourse(scenario, self._settings, limits)
        self.memory = controller.begin(1, seed, chase)
        """The controller's."""
        self.state, self._reason = ChaseState.IDLE, ""
        self._now_ns = self._last_step_ns = clock.now_ns()
        self._entered_ns = self._now_ns
        self._origin_m: Point | None = None
        self._movements = self._deaf_windows = self._recorder_failures = 0
        self._operator_holds = self._overrides = False
        self._course_reason = ""
        self._retry_ns = self._now_ns
        self._last_decision: Decision | None = None
        self._to_explain: Observation | None = None
        self._explanation: Explanation | None = None
        self._condition = Condition.TRACKING
        self._asked_m = np.zeros(3)

    # What the operator says

    def start(self) -> None:
        """Begin to command trackers."""
        if self.state is ChaseState.IDLE:
            self._go(ChaseState.CONNECTING, "the operator starts")

    def override(self) -> None:
        """Begin although the preflight has not passed."""
        if self.state in {ChaseState.IDLE, ChaseState.CONNECTING}:
            self._overrides = True

    def hold(self) -> None:
        """Stay until ``resume``."""
        if self.state in UNDER_WAY and not self._operator_holds:
            self._operator_holds = True
            self._hold("the operator holds")

    def resume(self) -> None:
        """Go on after a false ``REACHED``, or after holding, also with who was left out and is where it should be."""
        if self.state is ChaseState.REACHED:
            self._judge.forget()
            self._go(ChaseState.HOLDING, "the operator says that it is not reached")
        elif self.state is ChaseState.HOLDING:
            self._swarm.forgive()
            if self._operator_holds:
                self._go(ChaseState.HOLDING, "the operator resumes")
        self._operator_holds = False

    def declare_reached(self) -> None:
        """The operator sees the target. Where it is to be followed the word begins that, and a second one ends it."""
        if self.state not in UNDER_WAY:
            return
        if isinstance(self._judge, FlightCourse) and self.state in IN_FLIGHT:
            self._judge.declare_reached()
            if self._judge.state is ChaseState.FOLLOWING:
                self._go(ChaseState.FOLLOWING, "the operator says so")
                return
        self._stop(ChaseState.REACHED, "the operator says so")

    def abort(self) -> None:
        """Tell the trackers to hold, then nothing any more."""
        if self.state is not ChaseState.ABORTED:
            self._stop(ChaseState.ABORTED, "the operator aborts")

    # The loop

    def listen(self) -> None:
        """Take in what has come. Each step does; in between it is worth it because the clocks of the trackers are known
        as well as the moments of arrival.
        """
        self._now_ns = self._clock.now_ns()
        self._swarm.listen(self._link.receive(), self._now_ns)

    def step(self) -> None:
        """Whatever there is to do now."""
        self.listen()
        elapsed_s, self._last_step_ns = (self._now_ns - self._last_step_ns) / 1e9, self._now_ns
        if self.state is not ChaseState.IDLE:
            # While it is not known who contradicts the others nobody is told anything: by another frame it flew off.
            self._swarm.take_stock(may_join=self.state not in {ChaseState.CONNECTING, ChaseState.ABORTED})
        self._act()
        self._pace.advance(elapsed_s)
        self._speak()

    def _act(self) -> None:
        """What the state asks for."""
        if self.state in LED and not self._has_enough():
            self._hold(f"{len(self._enough())} trackers are too few{self._swarm.left_out_words()}")
        elif self.state is ChaseState.CONNECTING:
            self._connect()
        elif self.state in LED and self.state is self._listening():
            self._listen_on()
        elif self.state is ChaseState.MOVING:
            self._move()
        elif self.state is ChaseState.HOLDING:
            self._try_to_resume()

    def _connect(self) -> None:
        """Begin with all six, or after a while with enough of them that agree on where the formation is."""
        if self._swarm.there().sum() < self._settings.minimum_trackers:
            self._entered_ns = self._now_ns
            return
        estimate = self._swarm.formation_estimate()
        number = int(estimate.agrees.sum())
        self._swarm.begin_with(estimate)
        has_waited = number == NUM_TRACKERS or self._seconds_in_state() >= self._settings.connect_wait_s
        failed = [one for one in self._preflight() if one.passed is False]
        if has_waited and number >= self._settings.minimum_trackers and not failing(failed, self._overrides):
            self._origin_m = estimate.center_m
            self._swarm.take_stock(may_join=True)
            self._pace.stand(Move(estimate.center_m, estimate.spacing_m, (), ""), self._now_ns)
            words = [f"{number} trackers are there", f"overridden: {in_words(failed)}" if failed else ""]
            words.append(beyond_the_fence(self._scenario, self._filter.limits, metres(estimate.center_m)))
            self._go(self._listening(), "; ".join(filter(None, words)))

    def _preflight(self) -> tuple[PreflightCheck, ...]:
        """As it is now; nothing once the trackers are led."""
        if self.state not in {ChaseState.IDLE, ChaseState.CONNECTING}:
            return ()
        clocks_ahead_s = self._link.clocks_ahead_s()
        return preflight(self._scenario, self._filter.limits, self._swarm.snapshots(), clocks_ahead_s)

    def _listen_on(self) -> None:
        """Judge by the window and decide, once there is one."""
        window = self._pace.window(self._now_ns)
        if window is None:
            return
        judge, course = self._judge, self._course
        if isinstance(judge, NearnessJudge) and judge.is_reached(window.rssi_dbm, window.offset_m):
            self._stop(ChaseState.REACHED, "the levels are those of a target within the success radius")
        elif self._movements >= self._scenario.max_movements and not (course is not None and course.is_followed):
            refused = f"; {NOT_ONE_TRANSMITTER}" if course is not None and course.hears_two else ""
            self._stop(ChaseState.LOST, f"{self._movements} movements are spent{refused}")
        else:
            self._decide(window)

    def _decide(self, window: Window) -> None:
        """Ask the controller and set out, or hold where it fails. It sees positions in the chase's own frame."""
        assert self._origin_m is not None
        rssi_dbm, position_m = window.rssi_dbm, window.position_m - self._origin_m
        time_s = None if window.time_s is None else torch.from_numpy(window.time_s)[None]
        observation = Observation(torch.from_numpy(rssi_dbm).float()[None], torch.from_numpy(position_m)[None], time_s)
        try:
            action, memory = self._controller.decide(observation, self.memory)
            spacing_m = float(action.spacing_m[0])
            x_m, y_m, z_m = action.displacement_m[0].tolist()
            turn_rad = 0.0 if action.turn_rad is None else float(action.turn_rad[0])
            condition = getattr(memory, "condition", None)
            condition = Condition.TRACKING if condition is None else Condition(int(condition[0]))
        except Exception as error:
            self._hold(f"the controller failed: {type(error).__name__}: {error}", self._settings.retry_s)
            return
        is_number = all(map(math.isfinite, (spacing_m, x_m, y_m, z_m, turn_rad)))
        # What explains an earlier decision does not explain this one.
        self._explanation, self._to_explain = None, observation if is_number else None
        if is_number:
            self.memory, self._condition = memory, condition
            self._deaf_windows = self._deaf_windows + 1 if condition is Condition.DEAF else 0
        # In flight a target that is silent is looked for.
        is_deaf = self._deaf_windows >= DEAF_WINDOWS and isinstance(self._pace, StopAndListen)
        if not is_number or is_deaf:
            deaf = f"the controller has heard nothing for {self._deaf_windows} windows"
            movement, changed = 0, deaf if is_number else "the controller's action is no number"
            self._hold(changed, self._settings.retry_s)
        else:
            movement = self._movements = self._movements + 1
            changed = self._set_out(window, np.array([x_m, y_m, z_m]), spacing_m, turn_rad)
        told = spacing_m, (x_m, y_m, z_m), changed
        decision = Decision(self._now_ns, movement, rssi_dbm, position_m, *told, window.time_s)
        self._last_decision = decision
        self._record(decision)
        if movement and isinstance(self._judge, FlightCourse) and self._judge.state is not self.state:
            self._take_course(self._judge)

    def _set_out(self, window: Window, displacement_m: Point, spacing_m: float, turn_rad: float) -> str:
        """Carry out an action; returns in which way limits change it, else nothing."""
        if isinstance(self._pace, ListenInFlight) and isinstance(self._judge, FlightCourse):
            self._asked_m, flown_m = self._flown(self._pace, self._judge, window, displacement_m, spacing_m)
            return self._pace.pursue(self._asked_m, flown_m, turn_rad)
        assert isinstance(self._pace, StopAndListen)
        self._asked_m = displacement_m
        return self._fly(self._pace, window.center_m + displacement_m, spacing_m, f"movement {self._movements}")

    def _flown(
        self, pace: ListenInFlight, course: FlightCourse, window: Window, displacement_m: Point, spacing_m: float
    ) -> tuple[Point, float]:
        """What the controller says, or the course does where the target is followed or lost."""
        assert self._origin_m is not None
        assert window.time_s is not None
        assert pace.formation is not None
        belief = self._belief()
        self._course_reason = course.take(window, self._origin_m, belief)
        center_m = pace.formation.center_m - self._origin_m
        since_s = (self._now_ns - pace.window_since_ns) / 1e9 - float(window.time_s[-1])
        return course.flown(displacement_m, spacing_m, window, self._origin_m, center_m, since_s, belief)

    def _belief(self) -> Belief | None:
        """The controller's; None of one without."""
        return self._controller.belief(self.memory) if isinstance(self._controller, Believing) else None

    def _take_course(self, course: FlightCourse) -> None:
        if course.state is ChaseState.REACHED:
            self._stop(ChaseState.REACHED, self._course_reason)
        else:
            self._go(course.state, self._course_reason)

    @property
    def _course(self) -> FlightCourse | None:
        """Of trackers that listen while they fly."""
        return self._judge if isinstance(self._judge, FlightCourse) else None

    def _listening(self) -> ChaseState:
        """In this state windows are listened to."""
        return ChaseState.SAMPLING if self._course is None else self._course.state

    def _fly(self, pace: StopAndListen, center_m: Point, spacing_m: float, reason: str) -> str:
        """Set out for this formation, or what the safety filter makes of it; returns what it says."""
        present, swarm = pace.formation, self._swarm
        assert present is not None
        move = self._filter.move(
            present, center_m, spacing_m, swarm.stream.set_point_m, swarm.positions_m(), swarm.obstacles_m()
        )
        pace.set_out(move, self._now_ns)
        self._go(ChaseState.MOVING, f"{reason}; {move.reason}" if move.reason else reason)
        return move.reason

    def _move(self) -> None:
        """Sample once they are there."""
        assert isinstance(self._pace, StopAndListen)
        arrival = self._pace.arrival(self._now_ns, self._seconds_in_state())
        if arrival is not None:
            self._go(ChaseState.SAMPLING, arrival)

    def _hold(self, reason: str, for_s: float = 0.0) -> None:
        self._retry_ns = self._now_ns + round(for_s * 1e9)
        if self._course is not None:
            self._course.forget()
        self._pace.stop()
        self._go(ChaseState.HOLDING, reason)

    def _try_to_resume(self) -> None:
        if self._operator_holds or not self._has_enough() or self._now_ns < self._retry_ns:
            return
        reason, formation = "the cause of holding is gone", self._pace.formation
        if formation is None:
            self._go(ChaseState.CONNECTING, reason)
        elif isinstance(self._pace, StopAndListen) and not self._pace.is_in_place:
            self._fly(self._pace, formation.center_m, formation.spacing_m, reason)
        else:
            self._pace.stand(formation, self._now_ns)
            state = self._listening()
            # The alarm of a lost target is this reason: it must not read as if all were well.
            self._go(state, f"{reason}; the target is still lost" if state is ChaseState.SEARCHING else reason)

    def _speak(self) -> None:
        """The set-points, in every state that commands."""
        if self.state is ChaseState.ABORTED and self._seconds_in_state() > ABORT_S:
            return
        for set_point in self._swarm.set_points(self._epoch, self._now_ns):
            self._link.send(set_point)

    def explain(self) -> None:
        """Ask the controller about its last decision, for the snapshots: between steps, since it is only for people."""
        if self._to_explain is None or not isinstance(self._controller, Explaining):
            return
        try:
            self._explanation = self._controller.explain(self._to_explain, self.memory)
        except Exception:  # a picture is not worth a chase
            self._explanation = None
        self._to_explain = None

    def _has_enough(self) -> bool:
        return len(self._enough()) >= self._settings.minimum_trackers

    def _enough(self) -> list[int]:
        """The trackers to go on with: in flight also those that hear nothing of a target that is silent."""
        return self._swarm.usable() if isinstance(self._pace, StopAndListen) else self._swarm.counted()

    def _seconds_in_state(self) -> float:
        return (self._now_ns - self._entered_ns) / 1e9

    def snapshot(self) -> Snapshot:
        """Everything a page shows."""
        formation, course = self._pace.formation, self._course
        return Snapshot(
            time_ns=self._now_ns,
            epoch=self._epoch,
            state=self.state,
            reason=self._reason,
            movements=self._movements,
            origin_m=None if self._origin_m is None else metres(self._origin_m),
            center_m=None if formation is None else metres(formation.center_m),
            spacing_m=None if formation is None else formation.spacing_m,
            trackers=self._swarm.snapshots(),
            last_decision=self._last_decision,
            explanation=self._explanation,
            window_since_ns=self._pace.window_since_ns if self.state is self._listening() else None,
            recorder_failures=self._recorder_failures,
            preflight=self._preflight(),
            pulled_back=self._swarm.stream.pulled_back,
            condition=self._condition,
            share_within=None if course is None else course.newest_share,
            turned_rad=self._pace.turned_rad if isinstance(self._pace, ListenInFlight) else 0.0,
            following=None if course is None else course.following.told,
            asked_m=metres(self._asked_m),
            hears_two=course is not None and course.hears_two,
            looks_again=course is not None and course.looks_again,
        )

    def _stop(self, state: ChaseState, reason: str) -> None:
        self._pace.stop()
        self._go(state, reason)

    def _go(self, state: ChaseState, reason: str) -> None:
        self._now_ns = max(self._now_ns, self._clock.now_ns())
        self._record(Transition(self._now_ns, self.state, state, reason))
        self.state, self._reason, self._entered_ns = state, reason, self._now_ns

    def _record(self, entry: Transition | Decision) -> None:
        try:
            self._recorder(entry)
        except Exception:
            # A full disk must not stop the trackers.
            self._recorder_failures += 1


def require_judged(scenario: Scenario, controller: Controller, settings: ServiceSettings) -> None:
    """Refuse a controller by which nobody could say that a target that flies is reached, or where it is.

    Raises:
        InputError: it has no belief, and not only the operator is to say so; or trackers that stop are to follow.
    """
    if scenario.pace == "stop_and_listen":
        if settings.follow:
            raise InputError("--follow is refused: trackers that stop to listen do not follow")
        return
    if isinstance(controller, Believing):
        return
    if settings.follow:
        raise InputError(f"{controller.name} is refused where a target is followed: it has no belief to follow")
    if settings.reached_windows > 0:
        raise InputError(
            f"{controller.name} is refused in flight: it has no belief to judge by whether the target is reached; with "
            "--reached-windows 0 only the operator says so"
        )
