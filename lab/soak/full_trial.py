"""A trial of a fault script with the full stack: in a scenario, with the stock plugins, judged as recordings are."""

from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec

from robrain.deploy.recordings.scenario_surroundings import surroundings_of
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.recording.invariants.judging import Judging
from robrain.sim.faults.fault_spec import HARDWARE
from robrain.sim.links.link_spec import LinkSpec
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.stand_in.fault_script import FaultScript
from robrain.sim.stand_in.judge import QUIET_S, Broken, TeamInvariant, broken_in
from robrain.sim.stand_in.operator import OPERATOR, PointOperator
from robrain.sim.stand_in.promises import Promises
from robrain.sim.stand_in.trial import TrialVerdict, quiet
from robrain.sim.world.chargers import ChargerSpec
from robrain.sim.world.robot_specs import RobotSpec

PATIENCE_S = 150.0
TASK_S = 60.0
"""Time for everything to settle after the last fault: so long, and so much for each task."""
OPERATOR_TICKS = 5


def scenario_of(script: FaultScript) -> Scenario:
    """The scenario that a script runs in, without its motes.

    A scenario's robots are r1, r2 and so on; those of a script that was shrunk are named again, in their order.
    """
    scenario, radio = Scenario.builtin(script.scenario), script.radio
    names = {robot.name: f"r{number}" for number, robot in enumerate(script.robots, start=1)}
    faults = tuple(
        msgspec.structs.replace(
            one, robot=names.get(one.robot, one.robot), side=tuple(names.get(name, name) for name in one.side)
        )
        for one in script.faults
    )
    roster = tuple(
        RobotSpec(place_m=(robot.place.x_m, robot.place.y_m), hardware={"battery": {"soc_at_start": robot.soc}})
        for robot in script.robots
    )
    return scenario.replace(
        robots=len(script.robots),
        roster=roster,
        motes=0,
        chargers=tuple(ChargerSpec(place_m=(place.x_m, place.y_m)) for place in script.chargers),
        faults=faults,
        links=None if radio is None else LinkSpec(range_m=radio.range_m, loss=radio.loss, delay_s=radio.delay_s),
        seed=script.seed,
    )


def run_full_trial(
    script: FaultScript, should_stop: Callable[[], bool] = lambda: False, record: Path | None = None
) -> TrialVerdict:
    """Run a script to its end, or to `should_stop`, and judge it."""
    scenario = scenario_of(script)
    with quiet():
        judging = Judging(surroundings_of(scenario))
        run = LockstepRun(scenario.world(), record=record, scenario=scenario.name)
        trial = _Trial(run, script)
        try:
            run.follow(judging.hear)
            while not trial.is_over and not should_stop():
                trial.tick()
        finally:
            run.close()
    broken = [*broken_in(judging), *trial.unsettled(), *trial.lost()]
    return TrialVerdict(
        broken=tuple(broken), sim_time_s=round(run.sim_time_s, 1), done=trial.done, lost=run.lost_by_faults
    )


class _Trial:
    """One run with its operator."""

    def __init__(self, run: LockstepRun, script: FaultScript) -> None:
        self._run = run
        with run.acting(OPERATOR):
            wire = Endpoint(run.session, "default", run.clock, Drive.LOCKSTEP)
            self._operator = PointOperator(wire, script, repeats=True)
        self._script = script
        self._promises = Promises({order.task.id: order.task for order in script.tasks}, self._operator)
        self._ticks = 0
        self._quiet_ns: int | None = None
        self._limit_s = script.faults_end_s + PATIENCE_S + TASK_S * len(script.tasks)

    def tick(self) -> None:
        """Move the run on."""
        self._run.tick()
        self._ticks += 1
        if self._ticks % OPERATOR_TICKS == 0:
            with self._run.acting(OPERATOR):
                self._operator.step(self._run.clock.now_ns())

    @property
    def done(self) -> int:
        """Tasks that were done."""
        return sum(state is TaskState.DONE for state in self._states())

    @property
    def is_over(self) -> bool:
        """Whether everything has settled and stayed so, or should have."""
        run = self._run
        if run.sim_time_s > self._limit_s:
            return True
        if self._ticks % OPERATOR_TICKS:
            return False
        now_ns = run.clock.now_ns()
        if not self._is_settled:
            self._quiet_ns = None
        elif self._quiet_ns is None:
            self._quiet_ns = now_ns
        return self._quiet_ns is not None and now_ns - self._quiet_ns > to_ns(QUIET_S)

    def unsettled(self) -> Iterator[Broken]:
        """What is left at the end."""
        if not self._is_settled:
            left = [
                task
                for task, state in zip(self._operator.acknowledged, self._states(), strict=True)
                if state is None or not state.ended
            ]
            what = f"there is left: {', '.join(left) or 'nothing of the tasks'}"
            if not self._operator.is_content:
                what += "; the operator still waits for answers"
            yield Broken(TeamInvariant.UNSETTLED, round(self._run.sim_time_s, 1), what)

    def lost(self) -> Iterator[Broken]:
        """Promises that were not kept; a task may fail at a robot with broken hardware."""
        may_fail = any(fault.kind in HARDWARE for fault in self._script.faults)
        for task in self._operator.acknowledged:
            record = self._run.coordinator.tasks.find(task)
            if may_fail and record is not None and record.state in (TaskState.FAILED, TaskState.CANCELLED):
                continue
            if why := self._promises.why_broken(task, record):
                yield Broken(TeamInvariant.LOST, round(self._run.sim_time_s, 1), why)

    @property
    def _is_settled(self) -> bool:
        run = self._run
        if not (run.has_coordinator and run.faults_are_over and self._operator.is_content):
            return False
        return all(state is not None and state.ended for state in self._states())

    def _states(self) -> list[TaskState | None]:
        book = self._run.coordinator.tasks
        records = [book.find(task) for task in self._operator.acknowledged]
        return [None if record is None else record.state for record in records]
