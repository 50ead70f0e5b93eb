"""`robrain record` and `robrain foxglove`: a live team, written to a file or served to Foxglove."""

import time
from collections.abc import Callable
from pathlib import Path

from robrain.coordinator.recording.writer.provenance import Provenance
from robrain.coordinator.recording.writer.recorder import Recorder, RecordingSummary
from robrain.coordinator.recording.writer.recording_files import SplitAt, part_path
from robrain.deploy.errors import UsageError
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.errors import CallError, NobodyThere
from robrain.protocol.wire.topics import ROBOT_ALIVE, ROBOT_PLUGINS

PERIOD_S = 0.05
GATHER_S = 0.5
SUFFIX = ".mcap"
ASK_TIMEOUT_S = 1.0


def next_name(folder: Path, team: str) -> Path:
    """`TEAM-N.mcap` in a folder, with the first number that is free, parts of a split recording included."""
    number = 1
    while True:
        path = folder / f"{team}-{number}{SUFFIX}"
        if not path.exists() and not part_path(path, 1).exists():
            return path
        number += 1


def split_of(split_mb: float | None, split_s: float | None) -> SplitAt:
    """Read the options for splitting (UsageError if they are not above 0)."""
    for option, value in (("--split-mb", split_mb), ("--split-s", split_s)):
        if value is not None and not value > 0:
            raise UsageError(f"{option} {value:g}: expected a number above 0")
    return SplitAt(size_bytes=None if split_mb is None else max(round(split_mb * 1e6), 1), duration_s=split_s)


def record_team(
    wire: Endpoint,
    path: Path,
    split: SplitAt,
    *,
    visual: bool,
    should_stop: Callable[[], bool],
    on_progress: Callable[[Recorder], None],
) -> RecordingSummary:
    """Record a live team until `should_stop()`.

    The file begins with the robots' plugins and with each robot's map, which are queried at the start, because patches
    contain changes only.

    Raises:
        RecordingError: the file cannot be written.

    """
    robots = robots_there(wire)
    provenance = Provenance("", "", 0, None, Drive.LIVE.value, wire.team, plugins_of(wire, robots))
    recorder = Recorder(wire, path, provenance, split=split, visual=visual)
    try:
        recorder.ask_maps(wire, robots)
        while not should_stop():
            recorder.step()
            on_progress(recorder)
            time.sleep(PERIOD_S)
    finally:
        summary = recorder.close()
    return summary


def robots_there(wire: Endpoint) -> list[str]:
    """Names of the present robots."""
    presence = wire.watch(ROBOT_ALIVE)
    time.sleep(GATHER_S)
    return sorted(change.names["robot"] for change in presence.changes() if change.present)


def plugins_of(wire: Endpoint, robots: list[str]) -> dict[str, str]:
    """Loaded plugins of each robot, queried from it; robots that do not answer are left out."""
    told: dict[str, str] = {}
    for robot in robots:
        try:
            infos = wire.ask(ROBOT_PLUGINS, timeout_s=ASK_TIMEOUT_S, robot=robot)
            told[f"robots/{robot}.json"] = ROBOT_PLUGINS.payloads.write(infos).decode()
        except (CallError, NobodyThere):
            continue
    return told


def serve_foxglove(
    wire: Endpoint, host: str, port: int, on_ready: Callable[[str], None], should_stop: Callable[[], bool]
) -> None:
    """Serve the visual channels of a live team to Foxglove on a WebSocket, until `should_stop()`.

    Raises:
        WireError: the port cannot be listened on.
        ModuleNotFoundError: foxglove-sdk is not installed.

    """
    from robrain.coordinator.recording.foxglove.server import FoxgloveServer

    server = FoxgloveServer(wire, host, port)
    try:
        on_ready(server.address)
        while not should_stop():
            server.step()
            time.sleep(PERIOD_S)
    finally:
        server.close()
