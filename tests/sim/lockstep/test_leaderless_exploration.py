"""Exploration whose coordinator is killed on the way: the robots share out what is left, and hand back later."""

from collections.abc import Iterator
from contextlib import contextmanager

import msgspec
import pytest

from robrain.plugins.behavior.explore import ALONE
from robrain.sim.lockstep.lockstep import LockstepRun
from tests.bench.leaderless import LeaderlessCase

SMALL = LeaderlessCase(map="arena_small", robots=2, seed=4, time_limit_s=60.0)


@contextmanager
def killed(case: LeaderlessCase) -> Iterator[LockstepRun]:
    """A team that has begun to explore, three seconds and a half after its coordinator was killed."""
    scenario = case.scenario()
    run = LockstepRun(scenario.world(), planning=scenario.planning)
    try:
        while run.explored_fraction < 0.3:
            run.tick()
        run.end_coordinator()
        pass_time(run, 3.5)
        yield run
    finally:
        run.close()


def pass_time(run: LockstepRun, seconds: float) -> None:
    until_s = run.sim_time_s + seconds
    while run.sim_time_s < until_s:
        run.tick()


@pytest.mark.slow
def test_robots_alone_take_different_frontiers_and_a_coordinator_that_returns_hands_them_out_again() -> None:
    with killed(msgspec.structs.replace(SMALL, consensus=False)) as run:
        assert [host.board.behavior for host in run.hosts] == [ALONE, ALONE]
        one, other = (host.manager.get("explore").plugin.goal() for host in run.hosts)
        assert one.distance_m(other) > 2.0
        run.begin_coordinator()
        pass_time(run, 1.5)
        for host in run.hosts:
            assert host.board.behavior != ALONE
            assert host.desk.status.id.startswith("explore")
        known = run.explored_fraction
        pass_time(run, 5.0)
        assert run.explored_fraction > known + 0.05
        assert run.arena.collisions == 0
