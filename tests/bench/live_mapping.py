"""`python -m tests.bench.live_mapping`: the map of a live team whose agents are stopped at random times.

The team explores twice, in processes of this machine on loopback: once undisturbed, once while each agent's process is
stopped (SIGSTOP) and goes on (SIGCONT) again and again. Both runs last equally long.
"""

import heapq
import os
import signal
import statistics
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from robrain.deploy.errors import ChildFailed
from robrain.deploy.processes.children import Child
from robrain.deploy.processes.kernels import prepare_kernels
from robrain.lab.bench.figure import Figure, at_most, below, timing
from robrain.protocol.clock import LiveClock
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.team.arena_messages import ARENA_TRUTH, ArenaTruth
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.sim.scenarios.scenario import Scenario
from tests.bench.live_team import LiveTeam, live_team
from tests.bench.processes import PATIENCE_S, show

STOPPED_S = (0.2, 1.5)
"""Least and greatest time for which an agent is stopped."""
PER_MINUTE = 6.0
"""Mean number of stops of each agent in a minute in which it runs."""
MAP_BEGUN_S = 60.0
"""From then on, or from half time on, the map's accuracy counts: before, a few cells are a large share."""
WORSE_BOUND_POINTS = 2.0
OFF_BOUND_PERCENT = 2.0
SILENT_BOUND_S = 5.0
LOOK_S = 0.02


class LiveRun(NamedTuple):
    """What one run showed."""

    off_percent: list[float]
    """Occupied cells off the walls, sample by sample once the map has begun."""
    truth: ArenaTruth
    """The last one."""
    stops: int
    stopped_s: float
    """Sum over the agents."""


class Stops:
    """Stops processes at random times, each for a random time.

    Args:
        processes: which.
        rng: draws the times.
        begin_s: time of the first draw, on the clock of `step`.

    """

    def __init__(self, processes: list[Child], rng: np.random.Generator, begin_s: float) -> None:
        self.stops = 0
        self.stopped_s = 0.0
        self._processes = processes
        self._rng = rng
        self._due = [(begin_s + self._runs_for_s(), number, False) for number in range(len(processes))]
        heapq.heapify(self._due)

    def step(self, now_s: float) -> None:
        """Stop or continue whichever process is due."""
        while self._due and self._due[0][0] <= now_s:
            _, number, is_stopped = heapq.heappop(self._due)
            if is_stopped:
                _send(self._processes[number], signal.SIGCONT)
                next_s = now_s + self._runs_for_s()
            else:
                _send(self._processes[number], signal.SIGSTOP)
                lasts_s = float(self._rng.uniform(*STOPPED_S))
                self.stops, self.stopped_s = self.stops + 1, self.stopped_s + lasts_s
                next_s = now_s + lasts_s
            heapq.heappush(self._due, (next_s, number, not is_stopped))

    def close(self) -> None:
        """Let all go on."""
        for process in self._processes:
            _send(process, signal.SIGCONT)

    def _runs_for_s(self) -> float:
        return float(self._rng.exponential(60.0 / PER_MINUTE))


def measure(scenario: Scenario, scenario_argument: list[str], minutes: float) -> Iterator[Figure]:
    """Both runs, and their figures.

    Args:
        scenario: the floor and the team.
        scenario_argument: the arguments of `robrain arena` that name the same scenario.
        minutes: how long each run lasts.

    Raises:
        ChildFailed: a process did not start, or ended.

    """
    prepare_kernels()
    usual = run_team(scenario, scenario_argument, 60.0 * minutes, None)
    yield from _figures("undisturbed", usual)
    stopped = run_team(scenario, scenario_argument, 60.0 * minutes, np.random.default_rng([scenario.seed, 15]))
    yield from _figures("agents stopped", stopped)
    beside = f"{stopped.stops} stops, {stopped.stopped_s:.0f} s in all"
    bound = at_most(WORSE_BOUND_POINTS)
    worse = stopped.off_percent[-1] - usual.off_percent[-1]
    yield timing("cells off at the end, agents stopped less undisturbed", worse, "points", bound, beside)
    worse = max(stopped.off_percent) - max(usual.off_percent)
    yield timing("cells off at worst, agents stopped less undisturbed", worse, "points", bound, beside)


def run_team(
    scenario: Scenario, scenario_argument: list[str], lasts_s: float, rng: np.random.Generator | None
) -> LiveRun:
    """One run; agents are stopped at times drawn from `rng`, or not at all."""
    with live_team(scenario, scenario_argument) as team:
        wire = Endpoint(team.hub, team.team, LiveClock(), Drive.LIVE)
        agents = [child for name, child in team.children.items() if name not in ("arena", "coordinator")]
        begin_s = time.monotonic()
        stops = Stops(agents if rng is not None else [], rng or np.random.default_rng(0), begin_s)
        try:
            inbox = Inbox()
            wire.subscribe(inbox, ARENA_TRUTH)
            return _watch(team, inbox, stops, begin_s, lasts_s)
        finally:
            stops.close()
            wire.close()


def _watch(team: LiveTeam, inbox: Inbox, stops: Stops, begin_s: float, lasts_s: float) -> LiveRun:
    off_percent: list[float] = []
    truth: ArenaTruth | None = None
    begun_s = min(MAP_BEGUN_S, 0.5 * lasts_s)
    while (now_s := time.monotonic()) < begin_s + lasts_s:
        stops.step(now_s)
        for received in inbox.drain():
            truth = received.message
            if truth.map_accuracy is not None and now_s > begin_s + begun_s:
                off_percent.append(100 * truth.map_accuracy.share_off)
        ended = [child for child in team.children.values() if child.status is not None]
        if ended:
            raise ChildFailed(f"{ended[0].name} ended; it said: {' '.join(ended[0].lines) or 'nothing'}")
        if truth is None and now_s > begin_s + PATIENCE_S:
            raise ChildFailed(f"the arena published no ground truth within {PATIENCE_S:g} s")
        time.sleep(LOOK_S)
    if truth is None or not off_percent:
        raise ChildFailed("the arena published nothing about the map's accuracy")
    return LiveRun(off_percent, truth, stops.stops, stops.stopped_s)


def _figures(what: str, run: LiveRun) -> Iterator[Figure]:
    told = {robot.robot: robot.accuracy for robot in run.truth.robots if robot.accuracy is not None}
    bound = at_most(OFF_BOUND_PERCENT)
    yield timing(f"{what}: cells off at the end", run.off_percent[-1], "%", bound)
    beside = f"median {statistics.median(run.off_percent):.2f} %"
    yield timing(f"{what}: cells off at worst, once the map has begun", max(run.off_percent), "%", None, beside)
    yield timing(f"{what}: explored at the end", 100 * run.truth.explored_fraction, "%")
    yield timing(f"{what}: position RMSE, worst robot", max(each.rmse_m or 0.0 for each in told.values()), "m")
    silent_s = max(each.longest_silent_divergence_s for each in told.values())
    yield timing(f"{what}: silent divergence, longest", silent_s, "s", below(SILENT_BOUND_S))
    yield timing(f"{what}: collisions", float(sum(robot.collisions for robot in run.truth.robots)))


def _send(process: Child, number: signal.Signals) -> None:
    with suppress(ProcessLookupError):
        os.kill(process.pid, number)


if __name__ == "__main__":
    FLOOR = "examples/maps/clinic.yaml"
    TEAM = Scenario.from_map(FLOOR).replace(robots=4, seed=1)
    WORDS = ["--map", FLOOR, "--robots", "4", "--seed", "1"]
    show("Accuracy of the map of a live team", measure(TEAM, WORDS, 15.0))
