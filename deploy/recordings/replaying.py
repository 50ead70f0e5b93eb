"""`robrain replay`: publishes a recording on the wire, by the wall clock."""

import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from robrain.deploy.errors import UsageError
from robrain.protocol.clock import Clock
from robrain.protocol.wire.endpoint import Endpoint
from robrain.recording.replay.replay import Replay

PERIOD_S = 0.02
SEEK_S = 10.0
SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
KEYS = "space pauses, ← → seek 10 s, + − change the speed, 0 goes to the start, q ends"


def check_replay(speed: float, start_s: float, only_on_wire: Sequence[str]) -> None:
    """Check the options of `robrain replay`.

    Args:
        speed: recorded seconds per second.
        start_s: seconds after the first message.
        only_on_wire: given options that only apply to a replay on the wire.

    Raises:
        UsageError: one of them cannot be used; the text names it.

    """
    if not (math.isfinite(speed) and speed > 0):
        raise UsageError(f"--speed {speed:g}: expected a number above 0")
    if not (math.isfinite(start_s) and start_s >= 0):
        raise UsageError(f"--start {start_s:g}: expected seconds, 0 or more")
    if only_on_wire:
        raise UsageError(f"{', '.join(only_on_wire)}: only for a replay on the wire; add --no-dashboard")


class ReplayKeys:
    """Applies keys of a terminal to a replay.

    Args:
        replay: the running one.
    """

    def __init__(self, replay: Replay) -> None:
        self._replay = replay
        self.ended = False
        """Whether q was pressed."""

    def press(self, key: str) -> None:
        """Apply a key: `space`, `left`, `right`, `+`, `-`, `0`, `q`; others do nothing."""
        player = self._replay.player
        if key == "space":
            player.pause() if player.playing else player.play()
        elif key in ("left", "right"):
            self._replay.seek(player.position_s + (SEEK_S if key == "right" else -SEEK_S))
        elif key in ("+", "-"):
            self._change_speed(faster=key == "+")
        elif key == "0":
            self._replay.seek(0.0)
        elif key == "q":
            self.ended = True

    def _change_speed(self, *, faster: bool) -> None:
        player = self._replay.player
        others = [speed for speed in SPEEDS if (speed > player.speed if faster else speed < player.speed)]
        if others:
            was_playing = player.playing
            player.play(min(others) if faster else max(others))
            if not was_playing:
                player.pause()


def run_replay(
    endpoint: Endpoint,
    clock: Clock,
    path: Path,
    speed: float,
    *,
    loop: bool,
    should_stop: Callable[[], bool],
    on_progress: Callable[[float], None],
    on_open: Callable[[Replay], None] | None = None,
) -> bool:
    """Publish a recording on the wire.

    Args:
        endpoint: whose team's keys are used.
        clock: the wall clock.
        path: an MCAP file.
        speed: recorded seconds per second.
        loop: begin again at the end.
        should_stop: called at every step.
        on_progress: called with the published share, 0 to 1.
        on_open: called with the replay before it begins, to seek or pause it.

    Returns:
        Whether the end was reached.

    Raises:
        RecordingError: the file is not a robrain recording, or cannot be read.

    """
    replay = Replay(endpoint, path, speed=speed, loop=loop)
    try:
        if on_open is not None:
            on_open(replay)
        while not replay.done:
            if should_stop():
                return False
            replay.step(clock.now_ns())
            on_progress(replay.progress)
            time.sleep(PERIOD_S)
        return True
    finally:
        replay.close()
