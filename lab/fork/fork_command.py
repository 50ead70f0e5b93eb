"""`robrain fork`: a fork of a recorded run from a moment on."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from robrain.deploy.command_line.command_group import SIMULATE, CommandApp
from robrain.deploy.command_line.options import JsonOption
from robrain.deploy.command_line.output import print_either, print_json

if TYPE_CHECKING:
    from robrain.sim.scenarios.driving import Progress

DIFFERENT = 1
"""Exit status if the run was not equal to the recording where it should be."""
INTERRUPTED = 130


fork_app = CommandApp(SIMULATE)


@fork_app.command()
def fork(
    recording: Annotated[Path, typer.Argument(help="A recording of `robrain run`, `demo`, `fork` or a script.")],
    at: Annotated[str, typer.Option("--at", metavar="TIME", help="The moment: 412s, 6m52s; 0 is the start.")],
    without: Annotated[
        list[str] | None, typer.Option(metavar="ROBOT", help="Switch this robot off at the moment; may be repeated.")
    ] = None,
    task: Annotated[
        list[str] | None,
        typer.Option(metavar="WORDS", help="Submit a task, with the words of `task add`; may be repeated."),
    ] = None,
    policy: Annotated[
        list[str] | None,
        typer.Option(metavar="FILE|KEY=VALUE", help="Plan with a [planning] file or with a value; may be repeated."),
    ] = None,
    fault: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ROBOT:KIND[:SECONDS]", help="Have hardware fail, such as r2:lidar_freezes:20; may be repeated."
        ),
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(help="Seconds to continue; default: until the end of the recorded run.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="MCAP file to write; default: NAME.fork-TIME.mcap beside it.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the file if it exists.")] = False,
    as_json: JsonOption = False,
    show_progress: Annotated[
        bool, typer.Option("--progress", help="With --json: also print progress lines at intervals.")
    ] = False,
) -> None:
    """Repeat a recorded run up to a moment, compare it with the recording so far, and continue with changes from there.

    Exit status 1 if the repeated part, or an unchanged run, differs from the recording.
    """
    from robrain.deploy.processes.kernels import prepare_kernels
    from robrain.lab.fork.change_words import changes_of, moment_s
    from robrain.lab.fork.fork_display import fork_display, show_fork
    from robrain.lab.fork.fork_result import fork_name
    from robrain.lab.fork.forking import fork_run
    from robrain.lab.fork.recorded_run import recorded_run
    from robrain.recording.reader.two_runs import compare_runs

    at_s = moment_s(at)
    path = output if output is not None else fork_name(recording, at_s)
    with recorded_run(recording) as recorded:
        changes = changes_of(
            at_s,
            without=without or (),
            tasks=task or (),
            policy=policy or (),
            faults=fault or (),
            in_force=recorded.policy_at(at_s),
        )
        prepare_kernels(quiet=as_json)
        with fork_display(at_s, quiet=as_json) as show:
            result = fork_run(
                recorded,
                at_s,
                changes,
                output=path,
                seconds=seconds,
                overwrite=overwrite,
                on_progress=_print_progress if as_json and show_progress else show,
            )
    runs = compare_runs(recording, path) if result.same_whole is not True else None
    print_either({"fork": result, "runs": runs}, lambda: show_fork(result, runs), as_json=as_json)
    if result.ended == "interrupted":
        raise typer.Exit(INTERRUPTED)
    if not result.same_before or result.same_whole is False:
        raise typer.Exit(DIFFERENT)


def _print_progress(now: "Progress") -> None:
    print_json({"progress": {"now_s": now.sim_time_s}})
