"""`robrain report`: a page of plots of one run or of several."""

from pathlib import Path
from typing import Annotated

import typer

from robrain.deploy.command_line.command_group import RECORDINGS, CommandApp
from robrain.deploy.command_line.options import JsonOption
from robrain.deploy.command_line.output import print_either

report_app = CommandApp(RECORDINGS)


@report_app.command()
def report(
    recordings: Annotated[list[Path], typer.Argument(help="A recording, or several to compare.")],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder to write to; default: NAME_report beside the first recording."),
    ] = None,
    forms: Annotated[
        str, typer.Option("--figures", help="Formats of the figures' files, such as svg,pdf,png.")
    ] = "svg",
    as_json: JsonOption = False,
) -> None:
    """Write a page of plots of one or several runs; several seeds are compared by mean and interval."""
    from robrain.deploy.command_line.terminal import results
    from robrain.deploy.recordings.recording_display import progress, shown
    from robrain.lab.report.report import write_report

    folder = output if output is not None else recordings[0].with_name(f"{recordings[0].stem}_report")
    with progress("reading and drawing", quiet=as_json) as show:
        written = write_report(recordings, folder, show, forms=[form.strip() for form in forms.split(",")])
    text = f"{shown(written.page)}, and {len(written.figures)} figures beside it"
    print_either(written, lambda: results().print(text, soft_wrap=True), as_json=as_json)
