"""The arena in the live drive: one tick after the other by the wall clock."""

import time
from collections.abc import Callable, Sequence

from robrain.sim.motes.serial_forwarder import SerialForwarder
from robrain.sim.world.arena import Arena

CATCH_UP_S = 0.5


def run_arena(arena: Arena, should_stop: Callable[[], bool], forwarders: Sequence[SerialForwarder] = ()) -> None:
    """Step an arena, and its base stations' forwarders, in real time until `should_stop()`.

    After a pause of the machine the arena makes up for at most half a second; the rest of the time is lost to the
    simulated world, so that it does not race.
    """
    due_s = time.monotonic()
    while not should_stop():
        arena.step()
        for forwarder in forwarders:
            forwarder.step()
        due_s += arena.tick_s
        ahead_s = due_s - time.monotonic()
        if ahead_s > 0:
            time.sleep(ahead_s)
        elif ahead_s < -CATCH_UP_S:
            due_s = time.monotonic()
