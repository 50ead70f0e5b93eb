"""Python function calls of a lockstep run: a measure of cost that is equal on every machine.

A robot's hot path is pure Python at 50 Hz, so the cost of a new feature shows here, whatever the machine's load. Calls
of C functions are not counted. The count depends on the versions of Python and numpy.
"""

import cProfile
import gc
from collections.abc import Callable

from robrain import Scenario
from robrain.algorithms.warm_up import warm_up
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.world.world import TICK_S


def calls_per_robot_second(
    scenario: Scenario, *, window_s: float, settle_s: float = 0.0, until: Callable[[LockstepRun], bool] | None = None
) -> float:
    """Python function calls per robot and simulated second of a whole run, arena and coordinator included.

    Args:
        scenario: the scenario to run.
        window_s: simulated seconds to count.
        settle_s: simulated seconds before the count.
        until: after `settle_s`, wait for this condition before the count.

    """
    warm_up()
    run = LockstepRun(scenario.world())
    profile = cProfile.Profile(builtins=False)
    collects = gc.isenabled()
    try:
        _tick(run, settle_s)
        while until is not None and not until(run):
            run.tick()
        gc.disable()  # a collection may call finalizers of unrelated objects
        profile.enable()
        _tick(run, window_s)
        profile.disable()
    finally:
        if collects:
            gc.enable()
        run.close()
    return sum(entry.callcount for entry in profile.getstats()) / (scenario.robots * window_s)


def _tick(run: LockstepRun, seconds: float) -> None:
    for _ in range(round(seconds / TICK_S)):
        run.tick()
