"""The team's map of a recording as files of ROS's map_server."""

from collections.abc import Callable
from pathlib import Path

from robrain.coordinator.recording.errors import RecordingError
from robrain.coordinator.recording.export.map_server_files import write_grid
from robrain.coordinator.recording.replay.player import Player


def write_map(
    recording: Path, path: Path, at_s: float | None = None, on_progress: Callable[[float], None] | None = None
) -> list[Path]:
    """Write the map as the team knew it; returns the YAML file and the picture.

    Args:
        recording: an MCAP file.
        path: the YAML file, which does not exist yet; the picture has its name with `.pgm`.
        at_s: seconds since the first message; the end if None.
        on_progress: told the share that is done, 0 to 1.

    Raises:
        RecordingError: the recording cannot be read or knows no map at that time, the time is not in it, or a file
            exists or cannot be written; then none is left.
    """
    picture = path.with_suffix(".pgm")
    for each in (path, picture):
        if each.exists():
            raise RecordingError(each, f"{each} exists already: give another name or move it away")
    show = on_progress or (lambda _share: None)
    player = Player(recording)
    try:
        if at_s is not None and not 0.0 <= at_s <= player.duration_s:
            raise RecordingError(recording, f"--at {at_s:g}: expected 0 to {player.duration_s:.2f} s, its duration")
        grid = player.map_at(player.duration_s if at_s is None else at_s)
    finally:
        player.close()
    show(0.5)
    if grid is None or not grid.known_count:
        raise RecordingError(recording, f"{recording} has no map at that time")
    try:
        written = write_grid(grid, path)
    except OSError as error:
        raise RecordingError(path, f"cannot write {path}: {error.strerror or error}") from error
    show(1.0)
    return written
