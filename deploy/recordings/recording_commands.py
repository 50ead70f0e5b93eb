"""The commands for recordings. Each reads its options and calls the code that does the work."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from robrain.deploy.command_line.command_group import RECORDINGS, CommandApp
from robrain.deploy.command_line.options import ConnectOption, JsonOption, TeamOption
from robrain.deploy.command_line.output import print_either
from robrain.deploy.errors import UsageError
from robrain.protocol.keys import DEFAULT_TEAM, check_name

FORMS = ("csv", "parquet", "html", "foxglove")


def export_recording(
    recording: Path, form: str, output: Path | None, on_progress: Callable[[float], None]
) -> list[Path]:
    """Write a recording in another format; returns the files.

    Args:
        recording: an MCAP file.
        form: one of `FORMS`.
        output: folder for tables, else a file; beside the recording if None.
        on_progress: called with the share that is done, 0 to 1.

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
        on_progress: called with the share that is done, 0 to 1.

    Raises:
        RecordingError: the recording cannot be read or has no map at that time, or the time is not in it. Also: a file
            exists or cannot be written; then no file remains.

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


recording_app = CommandApp(RECORDINGS)
foxglove_app = CommandApp(RECORDINGS)

DIFFERENT = 1
"""Exit status of `check` with problems, and of `diff` with a difference."""

RecordingArgument = Annotated[Path, typer.Argument(help="A recording, an MCAP file.")]


@recording_app.command()
def record(
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="MCAP file to write; default: runs/TEAM-N.mcap.")
    ] = None,
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    split_mb: Annotated[float | None, typer.Option(help="Continue in a new file after this many megabytes.")] = None,
    split_s: Annotated[float | None, typer.Option(help="Continue in a new file after this many seconds.")] = None,
    keep_gb: Annotated[
        float | None, typer.Option(help="Remove the oldest files of the series above this many gigabytes in total.")
    ] = None,
    keep_days: Annotated[float | None, typer.Option(help="Remove files of the series after this many days.")] = None,
    visual: Annotated[bool, typer.Option(help="Also write channels that Foxglove, Lichtblick and Rerun draw.")] = True,
    as_json: JsonOption = False,
    provenance: Annotated[Path | None, typer.Option(hidden=True, help="Written by `robrain up`.")] = None,
) -> None:
    """Record a live team until Ctrl-C; wait for the team if it is not running yet."""
    from robrain.deploy.command_line.options import next_file
    from robrain.deploy.processes.live_process import LiveStop, wire_when_there
    from robrain.deploy.recordings.recording_display import record_display, show_recorded
    from robrain.deploy.recordings.recording_live import keep_of, read_provenance, record_team, split_for, split_of
    from robrain.protocol.wire.hub import teams_there, wrong_team
    from robrain.recording.writer.recording_file import check_writable
    from robrain.recording.writer.rotation import Rotation, own_recordings

    check_name("team", team)
    split, keep = split_of(split_mb, split_s), keep_of(keep_gb, keep_days)
    if keep is not None:
        split = split_for(split, keep)
    comes_from = read_provenance(provenance) if provenance is not None else None
    if output is not None:
        if output.exists():
            raise UsageError(f"--output {output}: it exists already; give another name or move it away")
        check_writable(output)
    should_stop = LiveStop()
    with wire_when_there("record", connect, team, should_stop) as wire:
        if wire is None:
            return
        if (others := teams_there(wire)) and team not in others:
            sys.stderr.write(f"robrain: {wrong_team(f'nobody of team {team} is there yet', wire)}\n")
        path = output if output is not None else next_file(Path("runs"), team)
        rotation = None
        if keep is not None:
            rotation = Rotation(path.parent, own_recordings(path, is_given=output is not None), keep)
        with record_display(path, quiet=as_json) as show:
            summary = record_team(
                wire, path, split, rotation, comes_from, visual=visual, should_stop=should_stop, on_progress=show
            )
    print_either(summary, lambda: show_recorded(summary), as_json=as_json)


@foxglove_app.command()
def foxglove(
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    port: Annotated[int, typer.Option(help="Port on 127.0.0.1; 0 takes a free one.")] = 8765,
) -> None:
    """Serve a live team to Foxglove or Lichtblick, by a WebSocket on 127.0.0.1."""
    from robrain.deploy.command_line.output import print_result
    from robrain.deploy.processes.live_process import LiveStop, client_endpoint
    from robrain.deploy.recordings.recording_live import serve_foxglove

    check_name("team", team)
    should_stop = LiveStop()
    with client_endpoint(connect, team) as wire:
        serve_foxglove(wire, "127.0.0.1", port, lambda address: print_result(f"foxglove: {address}"), should_stop)


@recording_app.command()
def info(
    recording: RecordingArgument,
    every_key: Annotated[
        bool, typer.Option("--every-key", help="Print one line per key, also for topics with many keys.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Describe a recording: its origin, and rates and gaps of each key."""
    from robrain.deploy.recordings.recording_display import progress, show_contents
    from robrain.recording.reader.contents import read_contents

    with progress("reading", quiet=as_json) as show:
        contents = read_contents(recording, show)
    print_either(contents, lambda: show_contents(contents, every_key=every_key), as_json=as_json)


@recording_app.command()
def check(recording: RecordingArgument, as_json: JsonOption = False) -> None:
    """Check a recording: valid messages, no missing numbers, the run's invariants. Exit status 1 if a check fails."""
    from robrain.deploy.recordings.recording_display import progress, show_verdict
    from robrain.deploy.recordings.surroundings import surroundings_of_recording
    from robrain.recording.reader.checking import check_recording

    with progress("checking", quiet=as_json) as show:
        verdict = check_recording(recording, show, surroundings_of_recording(recording))
    print_either(verdict, lambda: show_verdict(verdict), as_json=as_json)
    if not verdict.good:
        raise typer.Exit(DIFFERENT)


@recording_app.command()
def diff(
    first: Annotated[Path, typer.Argument(help="A recording.")],
    second: Annotated[Path, typer.Argument(help="The other recording.")],
    as_json: JsonOption = False,
) -> None:
    """Print the first message in which two runs differ, side by side. Exit status 1 if they differ."""
    from robrain.deploy.recordings.recording_display import progress, show_difference, show_two_runs
    from robrain.recording.reader.two_runs import compare_runs, first_difference

    with progress("comparing", quiet=as_json) as show:
        difference, same = first_difference(first, second, show)
    runs = None
    if difference is not None:
        with progress("reading", quiet=as_json) as show:
            runs = compare_runs(first, second, show)

    def show_both() -> None:
        show_difference(first, second, difference, same)
        if runs is not None:
            show_two_runs(runs)

    print_either({"same": same, "difference": difference, "runs": runs}, show_both, as_json=as_json)
    if difference is not None:
        raise typer.Exit(DIFFERENT)


@recording_app.command()
def recover(
    recording: RecordingArgument,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="File to write; default: NAME_recovered.mcap in the same folder."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Write a complete file from a recording that is damaged or lacks its end."""
    from robrain.deploy.recordings.recording_display import progress, show_recovery
    from robrain.recording.reader.recovering import recover as recover_recording

    path = output if output is not None else recording.with_name(f"{recording.stem}_recovered{recording.suffix}")
    with progress("recovering", quiet=as_json) as show:
        recovery = recover_recording(recording, path, show)
    print_either(recovery, lambda: show_recovery(recovery), as_json=as_json)


@recording_app.command()
def export(
    recording: RecordingArgument,
    form: Annotated[
        str | None,
        typer.Option(
            "--to", help="csv (default) or parquet (one file per topic), html (a page that plays the run), foxglove."
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder (csv, parquet) or file to write; default: beside the recording."),
    ] = None,
    with_map: Annotated[
        bool, typer.Option("--map", help="Write the team's map instead, as ROS map_server files (.yaml, .pgm).")
    ] = False,
    at_s: Annotated[
        float | None, typer.Option("--at", help="With --map: seconds since the start; default: the end.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Export a recording for other tools: tables, a page that plays it, its map, or channels that Foxglove draws."""
    from robrain.deploy.recordings.recording_display import progress, show_files

    if with_map and form is not None:
        raise UsageError(f"--to {form}: leave it out with --map")
    if at_s is not None and not with_map:
        raise UsageError(f"--at {at_s:g}: only with --map")
    with progress("exporting", quiet=as_json) as show:
        if with_map:
            files = export_map(recording, output, at_s, show)
        else:
            files = export_recording(recording, form or "csv", output, show)
    print_either({"files": files}, lambda: show_files(files), as_json=as_json)
