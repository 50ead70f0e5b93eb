"""`robrain dashboard` and `robrain replay`: a team or a recording in a browser page, or a recording on the wire."""

import math
import socket
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from prompt_toolkit.input import create_input
from prompt_toolkit.keys import Keys
from rich.progress import BarColumn, Progress

from robrain.dashboard.html.elements import clock_text
from robrain.deploy.command_line.output import print_result
from robrain.deploy.command_line.terminal import console, print_line, text_column
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.children import DASHBOARD_READY
from robrain.deploy.processes.live_process import ANY_PORT, LiveStop, client_endpoint, live_endpoint, open_hub
from robrain.protocol.clock import LiveClock
from robrain.protocol.keys import check_name
from robrain.protocol.wire.session import listening_at, open_session

if TYPE_CHECKING:
    from robrain.dashboard.panels.what_if import ForkRunner
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


NAMES = {" ": "space", "=": "+", "c-c": "q"}
"""Maps the terminal's names of keys to those of `ReplayTerminal.press`."""


class ReplayTerminal:
    """Shows the position of a replay, and applies keys to it.

    Args:
        replay: the running one.
        bars: shows its position; None shows nothing.
        read_keys: the pressed keys, by the terminal's names.

    """

    def __init__(
        self, replay: "Replay", bars: Progress | None = None, read_keys: Callable[[], list[str]] = list
    ) -> None:
        self._replay, self._bars, self._read_keys = replay, bars, read_keys
        self._bar = bars.add_task("", total=1.0) if bars is not None else None
        self.ended = False
        """Whether q was pressed."""

    def update(self) -> None:
        """Draw the position, and apply pressed keys."""
        for key in self._read_keys():
            self.press(NAMES.get(key, key))
        if self._bars is not None and self._bar is not None:
            player = self._replay.player
            state = f"× {player.speed:g}" if player.playing else "paused"
            words = f"{clock_text(player.position_s)} of {clock_text(player.duration_s)}  {state}"
            self._bars.update(self._bar, completed=self._replay.progress, description=words)

    def press(self, key: str) -> None:
        """Apply a key: `space`, `left`, `right`, `+`, `-`, `0`, `q`; others have no effect."""
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
            player.set_speed(min(others) if faster else max(others))


@contextmanager
def replay_terminal(replay: "Replay") -> Iterator[ReplayTerminal]:
    """Progress bar and keys for the duration of the block, if stdin and stdout are a terminal."""
    if not console.is_terminal or not sys.stdin.isatty():
        yield ReplayTerminal(replay)
        return
    console.print(KEYS)
    keyboard = create_input()

    def pressed() -> list[str]:
        keys = [press.key for press in keyboard.read_keys()]
        return [key.value if isinstance(key, Keys) else key for key in keys]

    columns = (text_column("{task.description}"), BarColumn(bar_width=40))
    with keyboard.raw_mode(), Progress(*columns, console=console, auto_refresh=True) as bars:
        yield ReplayTerminal(replay, bars, pressed)


DEFAULT_DASHBOARD_PORT = 8080


def dashboard_command(connect: str | None, team: str, port: int | None) -> None:
    """Show a team until Ctrl-C."""
    from robrain.dashboard import run_dashboard

    should_stop = LiveStop()
    with client_endpoint(connect, team) as wire:

        def ready(url: str) -> None:
            should_stop.ready()
            _print_url(url)

        run_dashboard(wire, "127.0.0.1", _page_port(port), ready, should_stop)


def show_recording(
    recording: Path, what_if: "ForkRunner", port: int | None, speed: float = 1.0, start_s: float = math.inf
) -> None:
    """Show a recording in a browser page until Ctrl-C; it is paused at `start_s`, or its end, until *Play*.

    `what_if` runs it again from a moment, with changes.
    """
    from robrain.dashboard import ReplaySource, run_dashboard

    should_stop = LiveStop()
    source = ReplaySource(recording, speed=speed, start_s=start_s)
    run_dashboard(source, "127.0.0.1", _page_port(port), _print_url, should_stop, what_if)


def replay_on_wire(
    recording: Path, speed: float, *, loop: bool, connect: list[str], team: str, start_s: float, paused: bool
) -> None:
    """Publish a recording on the wire, once or in a loop."""
    from robrain.recording.replay.replay import Replay  # loads numba, which the page of a live team does not need

    check_name("team", team)
    should_stop, clock = LiveStop(), LiveClock()
    session = open_session(mode="client", connect=connect) if connect else open_hub(ANY_PORT)[0]
    with (
        closing(session),
        live_endpoint(session, team) as wire,
        closing(Replay(wire, recording, speed=speed, loop=loop)) as replay,
    ):
        print_line(f"{recording} as team {team} at {(connect or listening_at(session))[0]}")
        if start_s:
            replay.seek(start_s)
        if paused:
            replay.player.pause()
        with replay_terminal(replay) as terminal:
            while not (replay.done or should_stop() or terminal.ended):
                replay.step(clock.now_ns())
                terminal.update()
                time.sleep(PERIOD_S)


def _page_port(port: int | None) -> int:
    """The requested port; else the default if it is free on loopback, else 0 for a free one."""
    if port is not None:
        return port
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", DEFAULT_DASHBOARD_PORT))
        except OSError:
            return 0
    return DEFAULT_DASHBOARD_PORT


def _print_url(url: str) -> None:
    print_result(f"{DASHBOARD_READY}{url}")
