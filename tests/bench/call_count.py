"""Calls of Python functions that a lockstep run makes: a measure of cost that is equal on every machine.

The hot path of a robot is pure Python at 50 Hz, so what a new capability costs shows here, whatever else the machine
does. Calls of C functions are not counted. Other versions of Python and numpy make other calls.
"""

import cProfile
import gc
from collections.abc import Callable

from robrain import Scenario
from robrain.protocol.model.warm_up import warm_up
from robrain.sim.arena import TICK_S
from robrain.sim.lockstep import LockstepRun


def calls_per_robot_second(
    scenario: Scenario, *, window_s: float, settle_s: float = 0.0, until: Callable[[LockstepRun], bool] | None = None
) -> float:
    """Calls of Python functions for each robot and simulated second of a whole run, arena and coordinator included.

    Args:
        scenario: what is run.
        window_s: simulated seconds that are counted.
        settle_s: simulated seconds before that.
        until: then goes on, before the count, until this holds.

    """
    warm_up()
    run = LockstepRun(scenario.world())
    profile = cProfile.Profile(builtins=False)
    collects = gc.isenabled()
    try:
        _tick(run, settle_s)
        while until is not None and not until(run):
            run.tick()
        gc.disable()  # what a collection calls belongs to whoever else is in this process
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
