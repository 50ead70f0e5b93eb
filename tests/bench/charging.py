"""Chargers: how long four robots with small batteries take for many visits.

Real robots in lockstep; their batteries last some minutes, so that each has to charge. The team first explores the
floor, then the tasks come all at once. `python -m tests.bench.charging [SEED …]`.
"""

import statistics
import sys
from typing import NamedTuple

import numpy as np

from robrain.lab.bench.figure import Figure, above, at_least, deterministic
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import TaskState
from robrain.sim.firmware.battery import BatterySpec
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.robot.robot_hardware import RobotHardware
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.world.chargers import ChargerSpec
from tests.bench.planning import known_places
from tests.bench.processes import show
from tests.bench.side_by_side import side_by_side

FLOOR = "arena_small"
ROBOTS, TASKS = 4, 20
SEEDS = (1,)
CHARGERS = (1, 2, 4)
DOCKS = ((0.7, 0.7), (7.3, 0.7), (4.3, 5.4), (0.7, 5.4))
SMALL_WH = 4.0
SOC_AT_START = 0.4
CHARGER_W, CHARGE_A = 90.0, 5.0
"""One charger gives more than four robots draw that stand, or nobody could last."""
SERVICE_S = 30.0
"""At each place: what makes batteries empty here is standing."""
EXPLORED = 0.93
EXPLORE_LIMIT_S = 60.0
LONGEST_S = 900.0
CUT_OFF_SOC = 0.02


class Outcome(NamedTuple):
    """One run, from the moment at which the tasks came."""

    makespan_s: float
    done: int
    least_soc: float
    """Of any robot at any time."""
    charged: int
    """How often somebody came to a charger."""


def measure(seeds: tuple[int, ...] = SEEDS) -> list[Figure]:
    """The table's rows, for each number of chargers."""
    cases = [(seed, chargers) for chargers in CHARGERS for seed in seeds]
    outcomes = dict(zip(cases, side_by_side(_run_case, cases), strict=True))
    figures = []
    for chargers in CHARGERS:
        found = [outcomes[seed, chargers] for seed in seeds]
        done = sum(one.done for one in found)
        least = min(one.least_soc for one in found)
        team = f"{ROBOTS} robots, {TASKS} visits, {chargers} charger{'s' if chargers > 1 else ''}"
        figures += [
            deterministic(
                f"{team}: done, of {TASKS * len(seeds)}", done, "", at_least(TASKS * len(seeds)), _words(found)
            ),
            deterministic(f"{team}: least charge of any robot", 100 * least, "%", above(100 * CUT_OFF_SOC)),
        ]
    return figures


def _run_case(case: tuple[int, int]) -> Outcome:
    return run_tasks(*case)


def run_tasks(seed: int, chargers: int) -> Outcome:
    """Explore, then do a set of tasks that only the seed decides."""
    scenario = Scenario.builtin(FLOOR).replace(
        robots=ROBOTS,
        motes=0,
        chargers=tuple(ChargerSpec(place_m=place, power_w=CHARGER_W) for place in DOCKS[:chargers]),
        hardware=RobotHardware(battery=BatterySpec(capacity_wh=SMALL_WH, soc_at_start=SOC_AT_START, charge_a=CHARGE_A)),
    )
    with scenario.team(seed=seed, by="bench") as team:
        run = team.transport.run
        while run.explored_fraction < EXPLORED and run.sim_time_s < EXPLORE_LIMIT_S:
            run.tick()
        begun_s = run.sim_time_s
        for number, place in enumerate(_places(run, seed)):
            team.submit("visit", id=f"t{number}", place=place, service_s=SERVICE_S)
        least_soc, charged, docked = 1.0, 0, set[int]()

        def ended() -> bool:
            nonlocal least_soc, charged, docked
            least_soc = min([least_soc, *(one.board.battery.soc for one in run.hosts if one.board.battery is not None)])
            now = {robot for robot in run.arena.chargers.docked if robot is not None}
            charged, docked = charged + len(now - docked), now
            return all(record.state.ended for record in team.list())

        team.run_for(LONGEST_S, until=ended)
        done = sum(record.state is TaskState.DONE for record in team.list())
        return Outcome(run.sim_time_s - begun_s, done, least_soc, charged)


def _places(run: LockstepRun, seed: int) -> list[Point2D]:
    """Some of them several times."""
    known = known_places(run, np.random.default_rng([seed, 78]), 20, 0.8)
    return [known[number % len(known)] for number in range(TASKS)]


def _words(outcomes: list[Outcome]) -> str:
    mean_s = statistics.fmean(one.makespan_s for one in outcomes)
    done, charged = sum(one.done for one in outcomes), sum(one.charged for one in outcomes)
    return (
        f"{mean_s:.0f} s, {done} of {TASKS * len(outcomes)} done, {charged} charges,"
        f" least {100 * min(one.least_soc for one in outcomes):.0f} %"
    )


if __name__ == "__main__":
    seeds = tuple(int(text) for text in sys.argv[1:]) or SEEDS
    show("Chargers", measure(seeds))
