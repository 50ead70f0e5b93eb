"""The work of `robrain soak`: seeds of fault scripts, run and judged side by side, and the failing ones shrunk."""

import shlex
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from functools import cache
from pathlib import Path

import msgspec
import numpy as np

from robrain.deploy.processes.kernels import prepare_kernels
from robrain.deploy.recordings.surroundings import surroundings_of
from robrain.lab.bench.mapping_plan import errors_alone
from robrain.lab.soak.fault_script import (
    CancelOrder,
    FaultScript,
    HaltOrder,
    ScriptRadio,
    ScriptRobot,
    TaskInput,
    script_json,
)
from robrain.lab.soak.judge import Broken, Settling, TeamRule, broken_in
from robrain.lab.soak.operator import OPERATOR, Operator, breach_reason
from robrain.lab.soak.script_drawing import draw_script
from robrain.lab.soak.shrink import TRIALS_MAX, Shrinker, with_sides_of
from robrain.lab.soak.soak_run import quiet
from robrain.lab.soak.trial import TrialVerdict, run_trial
from robrain.lab.sweep.crew import LocalCrew
from robrain.lab.sweep.execution import execute
from robrain.lab.sweep.run_outcome import RunState
from robrain.lab.sweep.worker import is_asked_to_stop
from robrain.protocol.links.exchange import EVERYWHERE
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.recording.invariants.judging import Judging
from robrain.sim.faults.fault_spec import COORDINATOR, HARDWARE, FaultKind, FaultSpec
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.lockstep.pacing import StopOnInterrupt
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.world.chargers import ChargerSpec
from robrain.sim.world.link_spec import LinkSpec
from robrain.sim.world.robot_specs import RobotSpec

SCENARIO = "arena_small"
ROBOTS = 3
TASKS = 7
FASTER = 0.6
"""Times of a script are shortened to this share: paths are shorter than in the hall of points."""
ROOM_M = 0.45
"""Between a drawn place and the nearest wall."""
APART_M = 1.0
"""Between two robots at the start."""
HARDWARE_SHARE = 0.5
"""Share of the scripts with a hardware fault."""
BROKEN_S = (4.0, 20.0)
RADIO_SHARE = 0.3
"""Share of the scripts whose components communicate by radio."""
RANGE_M = (12.0, 25.0)
LOSS = (0.0, 0.1)
DELAY_S = (0.0, 0.03)
_RNG_OF_FULL = 17
_RNG_OF_RADIO = 18
_HARDWARE = (
    FaultKind.CAN_CUT,
    FaultKind.CAN_SHORTED,
    FaultKind.MOTORS_FAIL,
    FaultKind.LIDAR_FREEZES,
    FaultKind.MOTE_BASE_FLOODS,
    FaultKind.CARRIED_OFF,
)
CONNECTED = "r1"
"""Never killed: an agent that is started again finds its place by the maps of the others."""


PATIENCE_S = 150.0
TASK_S = 60.0
"""Time to settle after the last fault: `PATIENCE_S`, plus `TASK_S` for each task."""
OPERATOR_TICKS = 5


def scenario_of(script: FaultScript) -> Scenario:
    """The scenario that a script runs in, without its motes.

    A scenario's robots are r1, r2 and so on; the robots of a shrunk script are named again, in their order.
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
            run.follow(judging.receive)
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
        party = OPERATOR if run.world.links is None else EVERYWHERE  # the operator has no radio
        wire = Endpoint(run.session, "default", run.clock, Drive.LOCKSTEP, party=party)
        self._operator = Operator(wire, script, repeats=True)
        self._script = script
        self._ticks = 0
        self._settling = Settling()
        self._limit_s = script.faults_end_s + PATIENCE_S + TASK_S * len(script.tasks)

    def tick(self) -> None:
        """Move the run on."""
        self._run.tick()
        self._ticks += 1
        if self._ticks % OPERATOR_TICKS == 0:
            self._operator.step(self._run.clock.now_ns())

    @property
    def done(self) -> int:
        """Tasks that were done."""
        return sum(state is TaskState.DONE for state in self._states())

    @property
    def is_over(self) -> bool:
        """Whether the run has settled and stayed so, or should have."""
        run = self._run
        if run.sim_time_s > self._limit_s:
            return True
        return not self._ticks % OPERATOR_TICKS and self._settling.stays(self._is_settled, run.clock.now_ns())

    def unsettled(self) -> Iterator[Broken]:
        """Tasks that have not ended, and other open ends of the run."""
        if not self._is_settled:
            left = [
                task
                for task, state in zip(self._operator.acknowledged, self._states(), strict=True)
                if state is None or not state.ended
            ]
            what = f"there is left: {', '.join(left) or 'nothing of the tasks'}"
            if not self._operator.is_content:
                what += "; the operator still waits for answers"
            yield Broken(TeamRule.UNSETTLED, round(self._run.sim_time_s, 1), what)

    def lost(self) -> Iterator[Broken]:
        """Promises that were not kept; a task may fail at a robot with broken hardware."""
        may_fail = any(fault.kind in HARDWARE for fault in self._script.faults)
        asked = {order.task.id: order.task for order in self._script.tasks}
        for task in self._operator.acknowledged:
            record = self._run.coordinator.tasks.find(task)
            if may_fail and record is not None and record.state in (TaskState.FAILED, TaskState.CANCELLED):
                continue
            if breach := breach_reason(self._operator, asked, task, record):
                yield Broken(TeamRule.LOST, round(self._run.sim_time_s, 1), breach)

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


def draw_full_script(seed: int) -> FaultScript:
    """The script of a seed: that of points, made smaller, on a floor with walls.

    An agent's clock is never wrong, as sensors are stamped by the simulator's, and no battery is drained at once, as
    energy would not balance.
    """
    base = draw_script(seed)
    rng = np.random.default_rng([seed, _RNG_OF_FULL])
    robots = _robots(rng, min(ROBOTS, len(base.robots)))
    names = [robot.name for robot in robots]
    tasks = tuple(_task(rng, order) for order in base.tasks[:TASKS])
    ids = {order.task.id for order in tasks}
    return FaultScript(
        seed=seed,
        scenario=SCENARIO,
        robots=robots,
        chargers=_places()[:: len(_places()) - 1],
        method=base.method,
        tasks=tasks,
        cancels=tuple(
            CancelOrder(at_s=_sooner(order.at_s), task=order.task) for order in base.cancels if order.task in ids
        ),
        halts=tuple(HaltOrder(at_s=_sooner(halt.at_s), until_s=_sooner(halt.until_s)) for halt in base.halts),
        faults=(*_faults(base, names), *_hardware(rng, names)),
        radio=_radio(seed),
    )


def _radio(seed: int) -> ScriptRadio | None:
    """A radio that reaches across the floor, for some of the scripts."""
    rng = np.random.default_rng([seed, _RNG_OF_RADIO])
    if rng.random() >= RADIO_SHARE:
        return None
    range_m, loss, delay_s = rng.uniform(*RANGE_M), rng.uniform(*LOSS), rng.uniform(*DELAY_S)
    return ScriptRadio(range_m=round(float(range_m), 1), loss=round(float(loss), 2), delay_s=round(float(delay_s), 3))


def _robots(rng: np.random.Generator, count: int) -> tuple[ScriptRobot, ...]:
    found: list[ScriptRobot] = []
    while len(found) < count:
        place = _place(rng)
        if all(place.distance_m(other.place) >= APART_M for other in found):
            soc = round(float(rng.uniform(0.3, 1.0)), 2)
            found.append(ScriptRobot(name=f"r{len(found) + 1}", place=place, soc=soc))
    return tuple(found)


def _task(rng: np.random.Generator, order: TaskInput) -> TaskInput:
    return TaskInput(at_s=_sooner(order.at_s), task=msgspec.structs.replace(order.task, place=_place(rng)))


def _faults(base: FaultScript, names: list[str]) -> Iterator[FaultSpec]:
    for fault in with_sides_of(base, names):
        is_agent = fault.robot != COORDINATOR
        if fault.kind is FaultKind.DRAIN or (fault.kind is FaultKind.CLOCK_SKEW and is_agent):
            continue
        robot = fault.robot if not is_agent or fault.robot in names else names[-1]
        if fault.kind is FaultKind.KILL and robot == CONNECTED:
            robot = names[1]
        at_s = _sooner(fault.at_s)
        until_s = None if fault.until_s is None else max(_sooner(fault.until_s), round(at_s + 0.1, 1))
        yield msgspec.structs.replace(fault, robot=robot, at_s=at_s, until_s=until_s)


def _hardware(rng: np.random.Generator, names: list[str]) -> Iterator[FaultSpec]:
    if rng.random() >= HARDWARE_SHARE:
        return
    kind, robot = FaultKind(str(rng.choice(list(_HARDWARE)))), str(rng.choice(names))
    at_s = round(float(rng.uniform(1.0, 25.0)), 1)
    if kind is FaultKind.CARRIED_OFF:
        place = _place(rng)
        yield FaultSpec(robot=robot, kind=kind, at_s=at_s, place_m=(place.x_m, place.y_m))
    else:
        yield FaultSpec(robot=robot, kind=kind, at_s=at_s, until_s=round(at_s + float(rng.uniform(*BROKEN_S)), 1))


def _sooner(at_s: float) -> float:
    return round(FASTER * at_s, 1)


def _place(rng: np.random.Generator) -> Point2D:
    places = _places()
    return places[int(rng.integers(len(places)))]


@cache
def _places() -> tuple[Point2D, ...]:
    """Places of the floor with room for a robot."""
    plan = Scenario.builtin(SCENARIO).plan()
    rows, columns = np.nonzero(plan.clearance_m[::4, ::4] >= ROOM_M)
    half_m = 0.5 * plan.resolution_m
    return tuple(
        Point2D(
            round(plan.origin_x_m + 4 * int(column) * plan.resolution_m + half_m, 3),
            round(plan.origin_y_m + 4 * int(row) * plan.resolution_m + half_m, 3),
        )
        for row, column in zip(rows, columns, strict=True)
    )


class SoakTask(msgspec.Struct, frozen=True, kw_only=True):
    """Input of a worker."""

    seed: int
    trials_max: int = TRIALS_MAX
    """Trials to shrink a failing script; 0 leaves it as it is."""
    is_full: bool = False
    """Whether the script is one for the full stack."""


class SoakRecord(msgspec.Struct, frozen=True, kw_only=True):
    """Outcome of a seed."""

    seed: int
    state: RunState
    verdict: TrialVerdict | None = None
    script: FaultScript | None = None
    """The shrunk script of a failing seed."""
    trials: int = 0
    """Number of smaller scripts that were tried."""
    cpu_s: float = 0.0
    """Of the first run, without the shrinking."""
    error: str = ""


class SoakOptions(msgspec.Struct, frozen=True, kw_only=True):
    """Options of a soak."""

    seeds: Sequence[int]
    jobs: int
    minutes: float | None = None
    """No trial begins after this."""
    output: Path
    """Folder for the failing scripts."""
    trials_max: int = TRIALS_MAX
    is_full: bool = False
    """Whether scripts are run with the full stack."""
    quiet: bool = True


class FailedSeed(msgspec.Struct, frozen=True, kw_only=True):
    """A seed whose script breaks an invariant."""

    seed: int
    broken: tuple[Broken, ...]
    faults: int
    """Number of faults of the shrunk script, and of its tasks."""
    tasks: int
    file: Path
    """The shrunk script."""

    @property
    def repeat(self) -> str:
        """The command that runs it again."""
        return shlex.join(("robrain", "soak", "--repeat", str(self.file)))


class SoakResult(msgspec.Struct, kw_only=True):
    """Results of a soak so far."""

    runs: int = 0
    """Trials that have ended, without interrupted ones."""
    failures: list[FailedSeed] = []
    errors: list[str] = []
    """Trials whose process died."""
    sim_time_s: float = 0.0
    cpu_s: float = 0.0
    wall_time_s: float = 0.0
    tasks_done: int = 0
    lost: int = 0
    """Messages that faults of the wire have lost."""
    faults: dict[str, int] = {}
    """Number of faults by kind."""
    interrupted: bool = False

    @property
    def speed(self) -> float:
        """Simulated time by CPU time."""
        return self.sim_time_s / self.cpu_s if self.cpu_s else 0.0


def draw(seed: int, *, is_full: bool) -> FaultScript:
    """The script of a seed, for the full stack or for points."""
    return draw_full_script(seed) if is_full else draw_script(seed)


def run_script(script: FaultScript, should_stop: Callable[[], bool] = lambda: False) -> TrialVerdict:
    """Run a script with its purpose, and judge it."""
    return run_full_trial(script, should_stop) if script.scenario else run_trial(script, should_stop)


def soak_one(task: SoakTask) -> SoakRecord:
    """Run the script of a seed, and shrink it if it breaks an invariant; in a worker process."""
    with errors_alone():
        script = draw(task.seed, is_full=task.is_full)
        began_s = time.process_time()
        verdict = run_script(script, is_asked_to_stop)
        cpu_s = time.process_time() - began_s
        if is_asked_to_stop():
            return SoakRecord(seed=task.seed, state=RunState.INTERRUPTED)
        if not verdict.broken:
            return SoakRecord(seed=task.seed, state=RunState.DONE, verdict=verdict, cpu_s=cpu_s)
        invariant = verdict.broken[0].invariant

        def fails(smaller: FaultScript) -> bool:
            if is_asked_to_stop():
                return False
            return any(one.invariant is invariant for one in run_script(smaller).broken)

        shrinker = Shrinker(fails, task.trials_max)
        shrunk = shrinker.shrink(script) if task.trials_max else script
        return SoakRecord(
            seed=task.seed, state=RunState.DONE, verdict=verdict, script=shrunk, trials=shrinker.trials, cpu_s=cpu_s
        )


def soak(options: SoakOptions, on_progress: Callable[[SoakResult], None] = lambda _result: None) -> SoakResult:
    """Run all seeds, to the end, to the time limit or to Ctrl-C; write each failing script once it is shrunk."""
    prepare_kernels(quiet=options.quiet)
    result, began_s = SoakResult(), time.monotonic()
    kinds: Counter[str] = Counter()

    def keep(record: SoakRecord) -> None:
        if record.state is RunState.INTERRUPTED:
            return
        result.runs += 1
        result.wall_time_s = time.monotonic() - began_s
        if record.verdict is None:
            result.errors.append(f"seed {record.seed}: {record.error}")
        else:
            _add(result, record, record.verdict, options.output)
            kinds.update(fault.kind.value for fault in draw(record.seed, is_full=options.is_full).faults)
            result.faults = dict(kinds.most_common())
        on_progress(result)

    with StopOnInterrupt() as interrupt, closing(LocalCrew(options.jobs, soak_one)) as crew:

        def should_stop() -> bool:
            is_late = options.minutes is not None and time.monotonic() - began_s > 60.0 * options.minutes
            return interrupt.requested or is_late

        tasks = [SoakTask(seed=seed, trials_max=options.trials_max, is_full=options.is_full) for seed in options.seeds]
        execute(tasks, crew, keep, without_result, should_stop)
        result.interrupted = interrupt.requested
    result.wall_time_s = time.monotonic() - began_s
    return result


def without_result(task: SoakTask, state: RunState, error: str) -> SoakRecord:
    """The record of a trial that ended without one."""
    return SoakRecord(seed=task.seed, state=state, error=error)


def _add(result: SoakResult, record: SoakRecord, verdict: TrialVerdict, output: Path) -> None:
    result.sim_time_s += verdict.sim_time_s
    result.cpu_s += record.cpu_s
    result.tasks_done += verdict.done
    result.lost += verdict.lost
    if record.script is None:
        return
    output.mkdir(parents=True, exist_ok=True)
    file = output / f"seed-{record.seed}.json"
    file.write_bytes(script_json(record.script))
    result.failures.append(
        FailedSeed(
            seed=record.seed,
            broken=verdict.broken,
            faults=len(record.script.faults) + len(record.script.halts),
            tasks=len(record.script.tasks),
            file=file,
        )
    )
