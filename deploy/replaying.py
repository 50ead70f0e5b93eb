"""`robrain replay`: a recording back on the wire, by the wall clock."""

import time
from collections.abc import Callable
from pathlib import Path

from robrain.coordinator.recording.replay import Replay
from robrain.protocol.wire.clock import Clock
from robrain.protocol.wire.endpoint import Endpoint

PERIOD_S = 0.02


def run_replay(
    endpoint: Endpoint,
    clock: Clock,
    path: Path,
    speed: float,
    *,
    loop: bool,
    should_stop: Callable[[], bool],
    on_progress: Callable[[float], None],
) -> bool:
    """Put a recording back on the wire.

    Args:
        endpoint: whose team's keys are used.
        clock: the wall's.
        path: an MCAP file.
        speed: recorded seconds a second.
        loop: begin again at the end.
        should_stop: asked every step.
        on_progress: told the share that has been put, 0 to 1.

    Returns:
        Whether the end was reached.

    Raises:
        RecordingError: the file is none of ours, or cannot be read.

    """
    replay = Replay(endpoint, path, speed=speed, loop=loop)
    try:
        while not replay.done:
            if should_stop():
                return False
            replay.step(clock.now_ns())
            on_progress(replay.progress)
            time.sleep(PERIOD_S)
        return True
    finally:
        replay.close()
