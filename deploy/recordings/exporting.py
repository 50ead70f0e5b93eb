"""`robrain export`: converts a recording for other tools."""

from collections.abc import Callable
from pathlib import Path

from robrain.deploy.errors import UsageError

FORMS = ("csv", "parquet", "html", "foxglove")


def export_recording(
    recording: Path, form: str, output: Path | None, on_progress: Callable[[float], None]
) -> list[Path]:
    """Write a recording in another format; returns the files.

    Args:
        recording: an MCAP file.
        form: one of `FORMS`.
        output: folder for tables, else a file; beside the recording if None.
        on_progress: told the share that is done, 0 to 1.

    Raises:
        UsageError: unknown format.
        RecordingError: the recording cannot be read, or a file exists already or cannot be written.

    """
    if form not in FORMS:
        raise UsageError(f"--to {form}: expected one of {', '.join(FORMS)}")
    if form in ("csv", "parquet"):
        from robrain.recording.export.exporting import export_tables

        folder = output if output is not None else recording.with_name(f"{recording.stem}_{form}")
        return list(export_tables(recording, folder, form, on_progress).values())
    if form == "html":
        from robrain.dashboard.replay.html_player import write_html

        path = output if output is not None else recording.with_suffix(".html")
        write_html(recording, path, on_progress)
        return [path]
    from robrain.recording.reader.recovering import with_visual

    path = output if output is not None else recording.with_name(f"{recording.stem}_foxglove{recording.suffix}")
    with_visual(recording, path, on_progress)
    return [path]


def export_map(
    recording: Path, output: Path | None, at_s: float | None, on_progress: Callable[[float], None]
) -> list[Path]:
    """Write the team's map of a recording as ROS map_server files; returns the YAML file and the picture.

    Args:
        recording: an MCAP file.
        output: the YAML file; `NAME_map.yaml` beside the recording if None. The picture has its name with `.pgm`.
        at_s: seconds since the first message; the end if None.
        on_progress: told the share that is done, 0 to 1.

    Raises:
        RecordingError: the recording cannot be read or knows no map at that time, the time is not in it, or a file
            exists or cannot be written; then none is left.

    """
    from robrain.recording.errors import RecordingError, check_absent, writing
    from robrain.recording.export.map_server_files import write_grid
    from robrain.recording.replay.player import Player

    path = output if output is not None else recording.with_name(f"{recording.stem}_map.yaml")
    for each in (path, path.with_suffix(".pgm")):
        check_absent(each)
    player = Player(recording)
    if at_s is not None and not 0.0 <= at_s <= player.duration_s:
        raise RecordingError(recording, f"--at {at_s:g}: expected 0 to {player.duration_s:.2f} s, its duration")
    grid = player.map_at(player.duration_s if at_s is None else at_s)
    on_progress(0.5)
    if grid is None or not grid.known_count:
        raise RecordingError(recording, f"{recording} has no map at that time")
    with writing(path):
        written = write_grid(grid, path)
    on_progress(1.0)
    return written
