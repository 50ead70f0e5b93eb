"""A thousand agents on the wire: what they cost a coordinator, and how old their states are when it speaks of them.

A few processes stand in for the agents. Each says for a few hundred robots what a real agent says: its token, a state
ten times a second, its plugins when it is asked, an answer to offers. State and list of plugins are those of a real
agent, taken from a short lockstep run. Hub and coordinator are processes as `robrain up` starts them.

The age of a state is measured from its stamp to the stamp of the coordinator's summary, by one clock, so that
everything in between counts: the hub, the coordinator's queue and its own step. So that the summary tells which state
it speaks of, the state of charge carries the time: its share of `CYCLE_S`.

Growth of memory is the slope of the minutes' medians after `WARM_UP_S`. By then everything periodic has happened once:
a minute after the start all robots are asked for their plugins again, which takes about five megabytes, once. Within a
minute the allocator varies by some megabytes. A leak shows in the slope in full.
"""

import multiprocessing
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from statistics import linear_regression
from typing import Any, NamedTuple

import msgspec
import numpy as np

from robrain.deploy.processes.live_process import client_endpoint, live_endpoint
from robrain.lab.bench.figure import Figure, at_most, timing
from robrain.protocol.clock import NS_PER_S
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL, ROBOT_PLUGINS
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_STATE, BatteryState, RobotState
from robrain.protocol.messages.tasks.offer_messages import ROBOT_OFFER, ROBOT_WITHDRAW, TaskAnswer
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE, TeamState
from robrain.protocol.topic import Query
from robrain.protocol.wire.endpoint import Drive, Endpoint
from tests.bench.live_team import TEAM, await_ready, hub_and_children
from tests.bench.processes import cpu_s, wait_for

ROBOTS = 1000
PROCESSES = 4
MINUTES = 10.0
RATE_HZ = 10.0
CYCLE_S = 1000.0
TICK_S = 0.005
SETTLING_S = 15.0
"""All are asked for their plugins, and those are read."""
WARM_UP_S = 75.0
"""The coordinator has asked all robots a second time for their plugins (`ASK_AGAIN_TOLD_NS`) and their chargers."""
TREND_MINUTES_MIN = 3
"""Fewer whole minutes tell no trend."""
PATIENCE_S = 90.0
CPU_BOUND = 50.0
AGE_BOUND_MS = 200.0
GROWTH_BOUND_MB = 2.0
"""For ten minutes."""
PAGE_MB = os.sysconf("SC_PAGE_SIZE") / 1e6


class Template(NamedTuple):
    """What one real agent says."""

    state: RobotState
    plugins: bytes
    home: dict[str, bytes]
    """What its skill `home` answers, by function."""


class ProcessSample(NamedTuple):
    """The coordinator's process at one moment."""

    at_s: float
    cpu_s: float
    resident_mb: float


def measure(robots: int = ROBOTS, minutes: float = MINUTES) -> Iterator[Figure]:
    """The figures, at the end.

    Args:
        robots: how many agents.
        minutes: for how long they are watched.

    Raises:
        ChildFailed: a process did not start, or the coordinator does not see all robots.

    """
    template = _template()
    with hub_and_children() as (folder, hub, endpoint, children):
        journal = str(folder / "bench.journal")
        words = ["coordinator", "--journal", journal, "--connect", endpoint, "--team", TEAM]
        coordinator = children.start("coordinator", words)
        await_ready(coordinator)
        with live_endpoint(hub, TEAM) as wire, _agents(endpoint, robots, template):
            summaries = Inbox()
            wire.subscribe(summaries, COORDINATOR_STATE)
            _await_all(summaries, robots)
            time.sleep(SETTLING_S)
            summaries.drain()
            looks, ages_s, unseen = _watch(coordinator.pid, summaries, 60.0 * minutes)
    yield from _figures(robots, looks, np.array(ages_s), unseen)


def _template() -> Template:
    """One robot of a real team that has just begun to drive."""
    from robrain.sim.lockstep.lockstep import LockstepRun
    from robrain.sim.scenarios.scenario import Scenario
    from robrain.sim.world.world import TICK_S as SIMULATED_TICK_S

    run = LockstepRun(Scenario.builtin("arena_small").replace(robots=1).world())
    try:
        wire, inbox = Endpoint(run.session, "default", run.clock, Drive.LOCKSTEP), Inbox()
        wire.subscribe(inbox, ROBOT_STATE)
        for _ in range(round(3.0 / SIMULATED_TICK_S)):
            run.tick()
        state = inbox.drain()[-1].message
        plugins = msgspec.json.encode(wire.ask(ROBOT_PLUGINS, robot=state.robot))
        home = {
            function: wire.ask(ROBOT_CALL, robot=state.robot, plugin="home", function=function)
            for function in ("chargers", "start")
        }
        wire.close()
    finally:
        run.close()
    return Template(msgspec.structs.replace(state, task=None, behavior="idle"), plugins, home)


# -- the coordinator's side ---------------------------------------------------------------------------------------


def _await_all(summaries: Inbox, robots: int) -> None:
    seen = 0

    def sees_all() -> bool:
        nonlocal seen
        for received in summaries.drain():
            seen = sum(robot.up for robot in received.message.robots)
        return seen >= robots

    wait_for(sees_all, lambda: f"the coordinator sees {seen} of {robots} robots", PATIENCE_S)


def _watch(pid: int, summaries: Inbox, for_s: float) -> tuple[list[ProcessSample], list[float], int]:
    """Look at the process once a second; the ages in all summaries, and how often a robot was not up in one."""
    looks, ages_s, unseen = [_look(pid)], [], 0
    while looks[-1].at_s - looks[0].at_s < for_s:
        time.sleep(1.0)
        looks.append(_look(pid))
        for received in summaries.drain():
            ages_s += _ages_s(received.message)
            unseen += sum(not robot.up for robot in received.message.robots)
    return looks, ages_s, unseen


def _look(pid: int) -> ProcessSample:
    pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
    return ProcessSample(time.monotonic(), cpu_s(pid), pages * PAGE_MB)


def _ages_s(summary: TeamState) -> list[float]:
    now_s = summary.stamp_ns / NS_PER_S
    return [(now_s - robot.soc * CYCLE_S) % CYCLE_S for robot in summary.robots if robot.soc is not None]


def _figures(robots: int, looks: list[ProcessSample], ages_s: np.ndarray[Any, Any], unseen: int) -> Iterator[Figure]:
    span_s = looks[-1].at_s - looks[0].at_s
    cpu = 100.0 * (looks[-1].cpu_s - looks[0].cpu_s) / span_s
    what, watched = f"{robots} agents at {RATE_HZ:g} Hz", f"{span_s / 60:.1f} min"
    yield timing(f"{what}: coordinator's CPU, share of a core", cpu, "%", at_most(CPU_BOUND), watched)
    median_ms, p99_ms = 1e3 * np.percentile(ages_s, (50, 99))
    yield timing(
        f"{what}: age of a state in the summary, p99",
        p99_ms,
        "ms",
        at_most(AGE_BOUND_MS),
        f"{len(ages_s)} states, median {median_ms:.0f} ms, oldest {1e3 * ages_s.max():.0f} ms",
    )
    yield timing(f"{what}: robots that a summary did not show as up", unseen, beside=watched)
    begin_mb, end_mb = looks[0].resident_mb, looks[-1].resident_mb
    growth_mb = growth_in_ten_minutes_mb(looks)
    if growth_mb is None:
        yield timing(f"{what}: coordinator's memory", end_mb, "MB", beside=f"{watched} are too short for its growth")
        return
    yield timing(
        f"{what}: growth of the coordinator's memory, for ten minutes",
        growth_mb,
        "MB",
        at_most(GROWTH_BOUND_MB),
        f"trend over {watched} after {WARM_UP_S:g} s; {begin_mb:.0f} MB at the beginning, {end_mb:.0f} MB at the end",
    )


def growth_in_ten_minutes_mb(looks: Sequence[ProcessSample]) -> float | None:
    """Ten times the least-squares slope of the medians of the whole minutes after `WARM_UP_S`; None if they are few."""
    minutes: dict[int, list[float]] = {}
    began_s = looks[0].at_s + WARM_UP_S
    whole = int((looks[-1].at_s - began_s) // 60.0)
    for look in looks:
        minute = int((look.at_s - began_s) // 60.0)
        if 0 <= minute < whole:
            minutes.setdefault(minute, []).append(look.resident_mb)
    if len(minutes) < TREND_MINUTES_MIN:
        return None
    medians_mb = [float(np.median(resident_mb)) for resident_mb in minutes.values()]
    return 10.0 * linear_regression(list(minutes), medians_mb).slope


# -- the agents' side ---------------------------------------------------------------------------------------------


@contextmanager
def _agents(endpoint: str, robots: int, template: Template) -> Iterator[None]:
    context = multiprocessing.get_context("spawn")
    stop = context.Event()
    shares = np.array_split(np.arange(robots), PROCESSES)
    processes = [
        context.Process(target=_drive, args=(endpoint, share.tolist(), template, stop), daemon=True) for share in shares
    ]
    for process in processes:
        process.start()
    try:
        yield
    finally:
        stop.set()
        for process in processes:
            process.join(10.0)
            if process.is_alive():
                process.kill()
                process.join()


def _drive(endpoint: str, numbers: list[int], template: Template, stop: Any) -> None:
    """One process of agents; each speaks at a moment of its own within the tenth of a second."""
    parent = os.getppid()
    names = [f"r{number:04d}" for number in numbers]
    with client_endpoint(endpoint, TEAM) as wire:
        states = [wire.publisher(ROBOT_STATE, robot=name) for name in names]
        entities = [_answer(wire, name, template) for name in names]
        for name in names:
            wire.token(ROBOT_ALIVE, robot=name)
        period_s = 1.0 / RATE_HZ
        began_s = time.monotonic()
        due_s = [began_s + period_s * index / len(names) for index in range(len(names))]
        while not stop.is_set() and os.getppid() == parent:
            now_s = time.monotonic()
            for index, name in enumerate(names):
                if due_s[index] <= now_s:
                    due_s[index] += period_s
                    states[index].put(_state(template.state, name))
            time.sleep(TICK_S)
        for queryables in entities:
            for queryable in queryables:
                queryable.undeclare()


def _state(like: RobotState, name: str) -> RobotState:
    assert like.battery is not None
    soc = (time.time_ns() / NS_PER_S) % CYCLE_S / CYCLE_S
    battery: BatteryState = msgspec.structs.replace(like.battery, soc=soc)
    return msgspec.structs.replace(like, robot=name, battery=battery)


def _answer(wire: Endpoint, name: str, template: Template) -> list[Any]:
    """Queryables of one agent. Their callbacks are direct: three threads for each agent would be too many."""
    import zenoh

    def declare(key: str, reply: bytes) -> Any:
        def take(query: zenoh.Query) -> None:
            with query:
                query.reply(key, reply)

        return wire.session.declare_queryable(key, zenoh.handlers.Callback(take, indirect=False))

    refused = msgspec.json.encode(TaskAnswer(accepted=False, why="it only stands in for a robot"))
    topics: dict[Query[Any, Any], bytes] = {
        ROBOT_PLUGINS: template.plugins,
        ROBOT_OFFER: refused,
        ROBOT_WITHDRAW: refused,
    }
    return [
        *(declare(topic.key(wire.team, robot=name), reply) for topic, reply in topics.items()),
        *(
            declare(ROBOT_CALL.key(wire.team, robot=name, plugin="home", function=function), reply)
            for function, reply in template.home.items()
        ),
    ]
