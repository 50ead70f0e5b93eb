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
        from robrain.coordinator.recording.export.exporting import export_tables

        folder = output if output is not None else recording.with_name(f"{recording.stem}_{form}")
        return list(export_tables(recording, folder, form, on_progress).files.values())
    if form == "html":
        from robrain.coordinator.recording.replay.html_player import write_html

        path = output if output is not None else recording.with_suffix(".html")
        write_html(recording, path, on_progress)
        return [path]
    from robrain.coordinator.recording.reader.recovering import with_visual

    path = output if output is not None else recording.with_name(f"{recording.stem}_foxglove{recording.suffix}")
    with_visual(recording, path, on_progress)
    return [path]


def export_map(
    recording: Path, output: Path | None, at_s: float | None, on_progress: Callable[[float], None]
) -> list[Path]:
    """Write the team's map of a recording as ROS map_server files.

    Args:
        recording: an MCAP file.
        output: the YAML file; `NAME_map.yaml` beside the recording if None.
        at_s: seconds since the first message; the end if None.
        on_progress: told the share that is done, 0 to 1.

    """
    from robrain.coordinator.recording.export.map_files import write_map

    path = output if output is not None else recording.with_name(f"{recording.stem}_map.yaml")
    return write_map(recording, path, at_s, on_progress)
