"""The coordinator in the live drive."""

import gc
import threading
import time
from collections.abc import Callable

from robrain.coordinator.coordinator import Coordinator
from robrain.protocol.gc_pause import GcPause
from robrain.protocol.workers import OwnedThread

PERIOD_S = 0.02
"""Longest time between two steps; messages are handled sooner."""
REST = 3.0
"""A step is followed by a rest of at least this many times its own time, and of `LEAST_REST_S`. With many robots
messages arrive all the time, and batches are cheaper."""
LEAST_REST_S = 0.002
JOIN_S = 3.0


def run_coordinator(coordinator: Coordinator, should_stop: Callable[[], bool], on_ready: Callable[[], None]) -> str:
    """Coordinate a team until `should_stop()`, or until another coordinator was elected; returns the name of that one.

    The team receives its coordinator first: plan processes start after that, and the libraries of the map are loaded
    beside the loop. Until it is there, the robots' patches wait.
    """
    arrived, wire = threading.Event(), coordinator.core.wire
    wire.on_receive = wire.on_waiting = arrived.set
    coordinator.team_map.hold()
    collector = None
    loading: OwnedThread | None = None
    try:
        coordinator.step()
        on_ready()
        coordinator.planning.prepare()
        collector = GcPause()
        loading = OwnedThread("loading", _load)
        is_loading = True
        while not should_stop() and not coordinator.end_reason:
            arrived.clear()
            began_s = time.thread_time()  # of the CPU: to wait for the disk is no reason to rest
            if is_loading and not loading.is_alive:
                is_loading = False
                coordinator.merge_held_patches()
            coordinator.step()
            rest_s = min(max(REST * (time.thread_time() - began_s), LEAST_REST_S), PERIOD_S)
            time.sleep(rest_s)
            arrived.wait(PERIOD_S - rest_s)
    finally:
        if collector is not None:
            collector.release()
        coordinator.close()
        if loading is not None:
            loading.close(JOIN_S)  # it may be amid code that does not bear the interpreter's end
    return coordinator.end_reason


def _load() -> None:
    # Imported here: numba and scipy take half a second, and robots that wait for their coordinator release their tasks.
    from robrain.algorithms.exploration.warm_up import warm_up

    warm_up()
    gc.freeze()  # what was loaded stays, as what was there when the collector was calmed
