"""Plans beside the coordinator: how soon it is there, how soon the first plan, and what its loop feels of them.

The process that plans is measured against the same work on a thread of the coordinator's own, in the same run.
`python -m tests.bench.live_planning`.
"""

import math
import pickle
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from robrain.coordinator.live import LEAST_REST_S, PERIOD_S
from robrain.coordinator.planning.energy_budget import DETOUR
from robrain.coordinator.planning.live_planner import LivePlanner, PlanRequest, Supposed, Supposition
from robrain.coordinator.planning.plan_in_force import PlanInForce
from robrain.coordinator.planning.plan_search import PlanSearch, rehearse
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.planning.snapshot import PlanningRobot, Snapshot
from robrain.lab.bench.figure import Figure, at_most, below, timing
from robrain.protocol.clock import LiveClock
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import BatteryState, RobotState
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.messages.team.team_messages import COORDINATOR_ALIVE, COORDINATOR_STATE
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import listening_at, open_session
from tests.bench.processes import LOOPBACK, ROBRAIN, cpu_s, running, show, wait_for
from tests.energy_models import energy_model

STARTS = 7
START_BOUND_S = 1.0
START_LIMIT_S = 60.0
SIZES = ((5, 50, 10.0), (20, 200, 50.0), (100, 1000, 600.0))
"""Robots, tasks, and the bound of the first plan in milliseconds."""
REPEATS = {50: 20, 200: 10, 1000: 3}
LOOP_S = 12.0
LOOK_S = 0.0005
DRY_RUN_S = 0.5
CHARGERS = 10
J_PER_M, STANDING_W, TASK_J = 30.0, 8.0, 80.0
HEAVY = "import numba, scipy.optimize, scipy.ndimage, pyvrp"
"""What a coordinator loads when it is up, or has another process load."""


class Start(NamedTuple):
    """One start of a coordinator's process."""

    live_s: float
    """Until its token and its first summary were there."""
    cpu_s: float


def measure() -> list[Figure]:
    """All figures."""
    rehearse()
    return [*_starts(), *(_first_plan(*size) for size in SIZES), *_dry_runs(), _loop()]


# -- start --------------------------------------------------------------------------------------------------


def _starts() -> list[Figure]:
    starts = measure_starts()
    heavy_s = statistics.median(_took_s([sys.executable, "-c", HEAVY]) for _ in range(3))
    live_s = statistics.median(start.live_s for start in starts)
    longest_s = max(start.live_s for start in starts)
    cpu_s = statistics.median(start.cpu_s for start in starts)
    first_s = statistics.median(_cold_plan_s() for _ in range(3))
    beside = (
        f"median {live_s:.2f} s, {cpu_s:.2f} s of CPU; loading what the map and the plans need takes {heavy_s:.2f} s"
    )
    what = f"coordinator, from its start until it is live, longest of {STARTS}"
    return [
        timing(what, longest_s, "s", at_most(START_BOUND_S), beside),
        timing("the planner's process, from its start to the first plan", first_s, "s"),
    ]


def measure_starts(starts: int = STARTS) -> list[Start]:
    """Start a coordinator again and again, on one journal, by a hub of its own."""
    hub = open_session(mode="router", listen=[LOOPBACK])
    wire = Endpoint(hub, DEFAULT_TEAM, LiveClock(), Drive.LIVE)
    try:
        where = next(endpoint for endpoint in listening_at(hub) if endpoint.startswith("tcp/"))
        summaries = Inbox()
        wire.subscribe(summaries, COORDINATOR_STATE)
        presence = wire.watch(COORDINATOR_ALIVE)

        def is_live() -> bool:
            for _ in presence.changes():
                pass
            return bool(presence.present)

        found = []
        with tempfile.TemporaryDirectory() as folder:
            for _ in range(starts):
                _wait(lambda: not is_live())
                summaries.drain()
                found.append(_start(lambda: is_live() and len(summaries) > 0, where, Path(folder)))
        return found
    finally:
        wire.close()
        hub.close()


def _start(is_live: Callable[[], bool], where: str, folder: Path) -> Start:
    began_s = time.monotonic()
    journal = str(folder / "team.journal")
    with running(*ROBRAIN, "coordinator", "--connect", where, "--journal", journal, stderr=None) as process:
        _wait(is_live)
        return Start(time.monotonic() - began_s, cpu_s(process.pid))


def _cold_plan_s() -> float:
    made = threading.Event()
    planner = LivePlanner(made.set)
    try:
        began_s = time.monotonic()
        planner.ask(team_situation(5, 50), PlanningPolicy())
        made.wait(START_LIMIT_S)
        return time.monotonic() - began_s
    finally:
        planner.close()


def _took_s(command: list[str]) -> float:
    began_s = time.monotonic()
    subprocess.run(command, check=True)
    return time.monotonic() - began_s


def _wait(until: Callable[[], object]) -> None:
    wait_for(until, "what is waited for does not come", START_LIMIT_S, LOOK_S)


# -- the first plan -----------------------------------------------------------------------------------------


def _first_plan(robots: int, tasks: int, bound_ms: float) -> Figure:
    policy = PlanningPolicy(deadline_s=0.001)  # the first plan is what counts
    made = threading.Event()
    planner = LivePlanner(made.set)
    here_ms, through_ms, link_ms = [], [], []
    search = PlanSearch()
    try:
        for repeat in range(REPEATS[tasks] + 1):
            snapshot = team_situation(robots, tasks, seed=repeat)
            began_s = time.perf_counter()
            planned = search.draft(snapshot, policy).planned()
            here_s = time.perf_counter() - began_s
            _wait(lambda: not planner.is_busy)
            made.clear()
            began_s = time.perf_counter()
            planner.ask(snapshot, policy)
            made.wait(START_LIMIT_S)
            through_s = time.perf_counter() - began_s
            _wait(lambda: bool(planner.finished_plans()) or not planner.is_busy)
            if repeat:  # the first waits for the process to be there
                here_ms.append(1e3 * here_s)
                through_ms.append(1e3 * through_s)
                link_ms.append(1e3 * _link_s(snapshot, policy, planned))
            _wait(lambda: bool(planner.finished_plans()) or not planner.is_busy)
    finally:
        planner.close()
    through, here, link = (statistics.median(found) for found in (through_ms, here_ms, link_ms))
    what = f"{robots} robots, {tasks} tasks: first plan, from the question to the answer"
    beside = f"the same work in place {here:.0f} ms; to write and read question and plan {link:.1f} ms"
    return timing(what, through, "ms", at_most(bound_ms), beside)


def _link_s(snapshot: Snapshot, policy: PlanningPolicy, planned: PlanInForce) -> float:
    began_s = time.perf_counter()
    pickle.loads(pickle.dumps(PlanRequest(1, snapshot, policy), pickle.HIGHEST_PROTOCOL))
    msgspec.msgpack.decode(msgspec.msgpack.encode(planned), type=PlanInForce)
    return time.perf_counter() - began_s


def team_situation(robots: int, tasks: int, seed: int = 0, number: int = 1) -> Snapshot:
    """Tasks all over an open floor of 6 m a side for each square root of a task, and robots with tight budgets."""
    rng = np.random.default_rng(seed)
    side_m = 6.0 * math.sqrt(tasks)
    places = [Point2D(*xy) for xy in rng.uniform(0.0, side_m, (tasks, 2)).tolist()]
    homes = [Point2D(*xy) for xy in rng.uniform(0.0, side_m, (robots, 2)).tolist()]
    chargers = tuple(Point2D(*xy) for xy in rng.uniform(0.0, side_m, (CHARGERS, 2)).tolist())
    share_j = 1.5 * tasks / robots * (0.7 * 6.0 * J_PER_M + TASK_J)
    members = {f"r{index}": _member(index, home, chargers, share_j) for index, home in enumerate(homes)}
    records = tuple(
        TaskRecord(task=Task(id=f"t{index}", kind="visit", place=place), state=TaskState.QUEUED)
        for index, place in enumerate(places)
    )
    return Snapshot(
        number=number, now_ns=0, cause="bench", records=records, ended=frozenset(), members=members, pauses={},
        served_s={}, floor=None, orders={},
    )  # fmt: skip


def _member(index: int, home: Point2D, chargers: tuple[Point2D, ...], share_j: float) -> PlanningRobot:
    """A robot that has energy for about its share of the tasks, and the way to a charger."""
    path_m = min(math.hypot(home.x_m - place.x_m, home.y_m - place.y_m) for place in chargers)
    usable_j = share_j + DETOUR * path_m * J_PER_M
    battery = BatteryState(
        voltage_v=16.0, current_a=1.0, temperature_c=20.0, soc=0.9, remaining_j=usable_j, remaining_low_j=usable_j
    )
    energy = energy_model(
        STANDING_W,
        0.0,
        J_PER_M,
        0.0,
        0.0,
        covariance=(0.01, *([0.0] * 14)),
        residual_w2_s=1.0,
        drift_w2_per_s=1e-5,
        relative_sd=0.03,
        usable_j=usable_j,
    )
    pose = Pose2D(home.x_m, home.y_m, 0.0)
    return PlanningRobot(RobotState(robot=f"r{index}", pose=pose, battery=battery, energy=energy), None, chargers, home)


# -- dry runs -----------------------------------------------------------------------------------------------


def _dry_runs() -> list[Figure]:
    """Answers to dry runs for 20 robots and 200 tasks, and what the loop feels of them."""
    policy, planner = PlanningPolicy(), LivePlanner(lambda: None)
    snapshot = team_situation(20, 200)
    far = TaskRecord(task=Task(id="far", kind="visit", place=Point2D(5e4, 0.0)), state=TaskState.QUEUED)
    hopeless = msgspec.structs.replace(snapshot, records=(*snapshot.records, far))
    asked = 0

    def answer_ms(situation: Snapshot, task: str) -> float:
        """Time to an answer with a plan; while the process starts, an answer has none."""
        nonlocal asked
        answers: list[Supposed] = []

        def is_answered() -> bool:
            answers.extend(planner.supposed())
            return bool(answers)

        while not any(one.planned is not None for one in answers):
            asked += 1
            began_s = time.perf_counter()
            answers.clear()
            planner.suppose(Supposition(asked, situation, policy, task))
            _wait(is_answered)
        return 1e3 * (time.perf_counter() - began_s)

    def ask_again() -> None:
        nonlocal asked
        asked += len(planner.supposed())
        planner.suppose(Supposition(asked, snapshot, policy, "t0"))

    try:
        answer_ms(snapshot, "t0")
        dry_ms = [answer_ms(snapshot, f"t{index}") for index in range(REPEATS[200])]
        causes_ms = [answer_ms(hopeless, "far") for _ in range(3)]
        alone = _gaps_ms(lambda: None)
        last_s = 0.0

        def ask_each_dry_run_period() -> None:
            nonlocal last_s
            if time.monotonic() - last_s > DRY_RUN_S:
                last_s = time.monotonic()
                ask_again()

        beside = _gaps_ms(ask_each_dry_run_period)
    finally:
        planner.close()
    what = "20 robots, 200 tasks"
    return [
        timing(f"{what}: answer to a dry run, longest", max(dry_ms), "ms", at_most(2000.0)),
        timing(f"{what}: answer why no plan includes a task, longest", max(causes_ms), "ms", at_most(60_000.0)),
        timing(
            f"{what}: gaps between the loop's steps beside a dry run each {DRY_RUN_S:g} s, p99",
            _p99(beside), "ms", at_most(2.0 * _p99(alone)), f"without {_p99(alone):.1f} ms"
        ),
    ]  # fmt: skip


# -- the loop beside ----------------------------------------------------------------------------------------


class _ThreadPlanner:
    """The same work on a thread: what the process is compared with."""

    def __init__(self) -> None:
        self.plans = 0
        self._snapshot: Snapshot | None = None
        self._policy = PlanningPolicy()
        self._has_ended = False
        self._thread = threading.Thread(target=self._run, daemon=True)

    def ask(self, snapshot: Snapshot, policy: PlanningPolicy) -> None:
        self._snapshot, self._policy = snapshot, policy
        self._thread.start()

    def take(self) -> int:
        plans, self.plans = self.plans, 0
        return plans

    def close(self) -> None:
        self._has_ended = True
        with suppress(RuntimeError):  # it was never asked
            self._thread.join()

    def _run(self) -> None:
        search = PlanSearch()
        assert self._snapshot is not None
        while not self._has_ended:
            draft = search.draft(self._snapshot, self._policy)
            draft.planned()
            began_s = time.monotonic()
            for _ in draft.solver.improve():
                if self._has_ended or time.monotonic() - began_s > self._policy.deadline_s:
                    break
            draft.planned()
            self.plans += 1


def _loop() -> Figure:
    snapshot = team_situation(100, 1000)
    alone = _gaps_ms(lambda: None)
    thread = _ThreadPlanner()
    thread.ask(snapshot, PlanningPolicy())
    try:
        beside_thread = _gaps_ms(lambda: None)
    finally:
        thread.close()
    planner = LivePlanner(lambda: None)
    planner.ask(snapshot, PlanningPolicy())
    plans = 0

    def follow() -> None:
        nonlocal plans
        plans += len(planner.finished_plans())
        if not planner.is_busy:
            planner.ask(snapshot, PlanningPolicy())

    try:
        _wait(lambda: bool(planner.finished_plans()))
        beside_process = _gaps_ms(follow)
    finally:
        planner.close()
    return timing(
        "gaps between the loop's steps beside plans for 100 robots and 1000 tasks, p99, over that beside a thread",
        100 * _p99(beside_process) / _p99(beside_thread),
        "%",
        below(100),
        f"{_p99(beside_process):.1f} ms, {max(beside_process):.0f} ms at most, {plans} plans taken; on a thread "
        f"{_p99(beside_thread):.1f} and {max(beside_thread):.0f} ms; without plans {_p99(alone):.1f} and "
        f"{max(alone):.0f} ms",
    )


def _gaps_ms(follow: Callable[[], None]) -> list[float]:
    """Times between steps of a loop like the coordinator's, which has little to do of its own."""
    arrived = threading.Event()
    gaps_ms: list[float] = []
    last_s = began_s = time.perf_counter()
    while last_s - began_s < LOOP_S:
        arrived.clear()
        follow()
        time.sleep(LEAST_REST_S)
        arrived.wait(PERIOD_S - LEAST_REST_S)
        now_s = time.perf_counter()
        gaps_ms.append(1e3 * (now_s - last_s))
        last_s = now_s
    return gaps_ms


def _p99(gaps_ms: list[float]) -> float:
    return float(np.quantile(gaps_ms, 0.99))


if __name__ == "__main__":
    show("Plans beside the live coordinator", measure())
