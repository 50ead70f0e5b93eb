"""The coordinator in the live drive."""

import time
from collections.abc import Callable

from robrain.coordinator.coordinator import Coordinator
from robrain.coordinator.journal.journal import Journal
from robrain.protocol.wire.endpoint import Endpoint

PERIOD_S = 0.02


def run_coordinator(
    wire: Endpoint, should_stop: Callable[[], bool], on_ready: Callable[[], None], journal: Journal | None = None
) -> None:
    """Coordinate a team until `should_stop()`."""
    coordinator = Coordinator(wire, journal)
    on_ready()
    while not should_stop():
        coordinator.step()
        time.sleep(PERIOD_S)
