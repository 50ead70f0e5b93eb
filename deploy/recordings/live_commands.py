"""Live processes that show a team or a recording: dashboard and replay."""

import socket
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from robrain.deploy.processes.dashboard_process import READY_PREFIX
from robrain.deploy.processes.live_process import ANY_PORT, LiveStop, client_session, live_endpoint, open_hub, tell
from robrain.protocol.clock import LiveClock
from robrain.protocol.keys import check_name
from robrain.protocol.wire.session import listening_at, open_session

if TYPE_CHECKING:
    from robrain.dashboard.panels.what_if import ForkRunner

DEFAULT_DASHBOARD_PORT = 8080


def dashboard_command(connect: str | None, team: str, port: int | None) -> None:
    """Show a team until Ctrl-C."""
    from robrain.dashboard import run_dashboard

    should_stop = LiveStop()
    with client_session(connect) as session, live_endpoint(session, team) as wire:

        def ready(url: str) -> None:
            should_stop.ready()
            _print_url(url)

        run_dashboard(wire, "127.0.0.1", _page_port(port), ready, should_stop)


def show_recording(
    recording: Path, what_if: "ForkRunner", port: int | None, speed: float = 1.0, start_s: float = 0.0
) -> None:
    """Show a recording in a browser page until Ctrl-C; it is paused at `start_s` until *Play* is pressed.

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
    from robrain.deploy.command_line.terminal import print_line
    from robrain.deploy.recordings.replay_terminal import replay_terminal
    from robrain.deploy.recordings.replaying import run_replay
    from robrain.recording.replay.replay import Replay

    check_name("team", team)
    should_stop = LiveStop()
    session = open_session(mode="client", connect=connect) if connect else open_hub(ANY_PORT)[0]
    with closing(session), live_endpoint(session, team) as wire:
        where = connect or listening_at(session)
        with replay_terminal() as terminal:

            def begin(replay: Replay) -> None:
                print_line(f"{recording} as team {team} at {where[0]}")
                terminal.open(replay)
                if start_s:
                    replay.seek(start_s)
                if paused:
                    replay.player.pause()

            run_replay(
                wire,
                LiveClock(),
                recording,
                speed,
                loop=loop,
                should_stop=lambda: should_stop() or terminal.ended,
                on_progress=terminal.show,
                on_open=begin,
            )


def _page_port(port: int | None) -> int:
    """The port that was asked for; else the default if nobody listens on it on loopback, else 0 for a free one."""
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
    tell(f"{READY_PREFIX}{url}")
