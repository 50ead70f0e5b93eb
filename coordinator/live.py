"""The coordinator in the live drive."""

import threading
import time
from collections.abc import Callable

from robrain.coordinator.coordinator import Coordinator
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.wire.collector import CalmCollector
from robrain.protocol.wire.endpoint import Endpoint

PERIOD_S = 0.02
"""Between two steps at the most; what arrives is attended to sooner."""
REST = 3.0
"""A step is followed by at least so many times its own time of rest, and by `LEAST_REST_S`: with many robots something
arrives all the time, and is worth more by the dozen."""
LEAST_REST_S = 0.002


def run_coordinator(
    wire: Endpoint,
    should_stop: Callable[[], bool],
    on_ready: Callable[[], None],
    journal: Journal | None = None,
    policy: PlanningPolicy | None = None,
) -> None:
    """Coordinate a team until `should_stop()`."""
    arrived = threading.Event()
    wire.on_heard = wire.on_waiting = arrived.set
    coordinator = Coordinator(wire, journal, policy)
    collector = CalmCollector()
    on_ready()
    try:
        while not should_stop():
            arrived.clear()
            began_s = time.thread_time()  # of the CPU: to wait for the disk is no reason to rest
            coordinator.step()
            rest_s = min(max(REST * (time.thread_time() - began_s), LEAST_REST_S), PERIOD_S)
            time.sleep(rest_s)
            arrived.wait(PERIOD_S - rest_s)
    finally:
        collector.release()
        coordinator.close()
