"""`robrain record` and `robrain foxglove`: a live team, written to a file or served to Foxglove."""

import time
from collections.abc import Callable
from pathlib import Path

import msgspec

from robrain.deploy.command_line.options import above_zero
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.live_process import LiveStop
from robrain.protocol.clock import steps
from robrain.protocol.errors import CallError, NobodyThere
from robrain.protocol.messages.robots.plugin_messages import ROBOT_PLUGINS
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.recording.provenance import Provenance
from robrain.recording.writer.recorder import Recorder, RecordingSummary
from robrain.recording.writer.recording_files import SplitAt
from robrain.recording.writer.rotation import KeepFiles, Rotation

PERIOD_S = 0.05
GATHER_S = 0.5
PROVENANCE_MAX_BYTES = 256 * 1024 * 1024
ASK_TIMEOUT_S = 1.0
DAY_S, HOUR_S = 86_400.0, 3600.0
PARTS = 20
"""Number of kept files, if the recording is not split otherwise."""


def split_of(split_mb: float | None, split_s: float | None) -> SplitAt:
    """Read the options for splitting (UsageError if they are not above 0)."""
    above_zero("--split-mb", split_mb)
    above_zero("--split-s", split_s)
    return SplitAt(size_bytes=None if split_mb is None else max(round(split_mb * 1e6), 1), duration_s=split_s)


def keep_of(keep_gb: float | None, keep_days: float | None) -> KeepFiles | None:
    """The limits of the kept files from the two options; None without both (UsageError if one is not above 0)."""
    above_zero("--keep-gb", keep_gb)
    above_zero("--keep-days", keep_days)
    if keep_gb is None and keep_days is None:
        return None
    return KeepFiles(
        size_bytes=None if keep_gb is None else max(round(keep_gb * 1e9), 1),
        age_s=None if keep_days is None else keep_days * DAY_S,
    )


def split_for(split: SplitAt, keep: KeepFiles) -> SplitAt:
    """Split of a recording whose old files are removed: whole files are removed, so there must be many.

    Raises:
        UsageError: a file would hold more than half of the kept data.

    """
    size, age_s = keep.size_bytes, keep.age_s
    if not split.splits:
        return SplitAt(
            size_bytes=None if size is None else max(size // PARTS, 1), duration_s=min(age_s or HOUR_S, HOUR_S)
        )
    if size is not None and (split.size_bytes is None or 2 * split.size_bytes > size):
        wanted = "expected --split-mb" if split.size_bytes is None else "expected a smaller --split-mb"
        raise UsageError(f"--keep-gb {size / 1e9:g}: {wanted}, at most half of this size")
    if age_s is not None and split.duration_s is not None and 2 * split.duration_s > age_s:
        raise UsageError(f"--split-s {split.duration_s:g}: expected at most half of --keep-days")
    return split


def record_team(
    wire: Endpoint,
    path: Path,
    split: SplitAt,
    rotation: Rotation | None,
    provenance: Provenance | None,
    *,
    visual: bool,
    should_stop: LiveStop,
    on_progress: Callable[[Recorder], None],
) -> RecordingSummary:
    """Record a live team until `should_stop()`.

    The file begins with the robots' plugins and with each robot's map, which are queried at the start, because patches
    contain changes only.

    Args:
        wire: the team's endpoint.
        path: the file.
        split: limits at which it continues in another file.
        rotation: removes the oldest recordings; None keeps all.
        provenance: origin of the team, if it is known; its robots are not asked for their plugins then.
        visual: whether channels are written that Foxglove and its like draw.
        should_stop: of this process; it reports that all topics of the team are subscribed.
        on_progress: called after each step.

    Raises:
        RecordingError: the file cannot be written.

    """
    robots = robots_there(wire)
    if provenance is None:
        provenance = Provenance("", "", 0, None, Drive.LIVE.value, wire.team, plugins_of(wire, robots))
    recorder = Recorder(wire, path, provenance, split=split, visual=visual, rotation=rotation)
    try:
        should_stop.ready()
        recorder.ask_maps(wire, robots)
        for _ in steps(should_stop, PERIOD_S):
            recorder.step()
            on_progress(recorder)
    finally:
        summary = recorder.close()
    return summary


def robots_there(wire: Endpoint) -> list[str]:
    """Names of the present robots."""
    presence = wire.watch(ROBOT_ALIVE)
    time.sleep(GATHER_S)
    return sorted(change.names["robot"] for change in presence.changes() if change.present)


def read_provenance(path: Path) -> Provenance:
    """Origin of a team, as `robrain up` wrote it (UsageError if the file cannot be read)."""
    try:
        with path.open("rb") as file:
            return msgspec.json.decode(file.read(PROVENANCE_MAX_BYTES), type=Provenance)
    except (OSError, msgspec.MsgspecError) as error:
        raise UsageError(f"--provenance {path}: {error}") from error


def plugins_of(wire: Endpoint, robots: list[str]) -> dict[str, str]:
    """Loaded plugins of each robot, queried from it; robots that do not answer are left out."""
    found: dict[str, str] = {}
    for robot in robots:
        try:
            infos = wire.ask(ROBOT_PLUGINS, timeout_s=ASK_TIMEOUT_S, robot=robot)
            found[f"robots/{robot}.json"] = ROBOT_PLUGINS.payloads.write(infos).decode()
        except (CallError, NobodyThere):
            continue
    return found


def serve_foxglove(
    wire: Endpoint, host: str, port: int, on_ready: Callable[[str], None], should_stop: Callable[[], bool]
) -> None:
    """Serve the visual channels of a live team to Foxglove on a WebSocket, until `should_stop()`.

    Raises:
        WireError: the port cannot be listened on.
        ModuleNotFoundError: foxglove-sdk is not installed.

    """
    from robrain.recording.foxglove.server import FoxgloveServer

    server = FoxgloveServer(wire, host, port)
    try:
        on_ready(server.address)
        for _ in steps(should_stop, PERIOD_S):
            server.step()
    finally:
        server.close()
