"""Runs of an ideal team, and what they took."""

import msgspec
import numpy as np

from robrain.algorithms.exploration.strategies import strategy_of
from robrain.sim.errors import RunFailed
from robrain.sim.ideal.ideal_team import IdealTeam
from robrain.sim.scenarios.driving import MILESTONES_PERCENT
from robrain.sim.scenarios.scenario import Scenario

IDLE_S = 4.0
"""After this time without a goal for any robot the run ends."""


class IdealResult(msgspec.Struct, frozen=True, kw_only=True):
    """What an ideal run took."""

    sim_time_s: float
    explored_fraction: float
    explored_percent_s: dict[int, float]
    """Simulated time at which 50, 90, 95 and 99 % were first known; without those that were not reached."""
    distance_m: float
    standing_s: float
    """Sum over the robots."""


def run_ideal(scenario: Scenario) -> IdealResult:
    """Explore a scenario's floor from its starts with ideal motion, by its strategy.

    Args:
        scenario: its floor, robots, seed, starts, lidar, radius and `planning` count.

    Raises:
        RobrainError: the scenario cannot be placed, or its strategy failed; in words.

    """

    def fail(name: str, why: str) -> None:
        raise RunFailed(f"the run ended at {team.time_s:.2f} s: exploration strategy {name} failed: {why}")

    world = scenario.world()
    policy, hardware = scenario.planning, scenario.hardware
    team = IdealTeam(
        world.plan,
        [robot.start for robot in world.robots],
        hardware.radius_m,
        hardware.lidar,
        strategy_of(policy.exploration, fail),
        policy.revise_s,
        np.random.default_rng([scenario.seed, 1]),
    )
    reached: dict[int, float] = {}
    idle_since_s = 0.0
    while team.time_s < scenario.time_limit_s:
        share = team.explored_fraction
        for percent in MILESTONES_PERCENT:
            if 100.0 * share >= percent and percent not in reached:
                reached[percent] = round(team.time_s, 3)
        if share >= scenario.until_explored:
            break
        team.step()
        idle_since_s = team.time_s if team.is_at_work else idle_since_s
        if team.time_s - idle_since_s > IDLE_S:
            break
    return IdealResult(
        sim_time_s=round(team.time_s, 3),
        explored_fraction=team.explored_fraction,
        explored_percent_s=reached,
        distance_m=sum(robot.distance_m for robot in team.robots),
        standing_s=sum(robot.standing_s for robot in team.robots),
    )
