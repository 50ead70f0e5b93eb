"""`robrain soak`. It reads its options and calls the code that does the work."""

from pathlib import Path
from typing import Annotated

import typer

from robrain.deploy.command_line.command_group import SIMULATE, CommandApp
from robrain.deploy.command_line.options import JsonOption
from robrain.deploy.command_line.output import print_either

soak_app = CommandApp(SIMULATE)

BROKEN = 1
"""Exit status if an invariant was broken."""
INTERRUPTED = 130


@soak_app.command()
def soak(
    runs: Annotated[int | None, typer.Option(help="Number of scripts; default: 100.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of the first script; the others follow.")] = 1,
    jobs: Annotated[int | None, typer.Option(help="Number of processes; default: one for each core.")] = None,
    minutes: Annotated[float | None, typer.Option(help="Begin no script after this time.")] = None,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for the scripts that fail.", show_default=True)
    ] = Path("runs/soak"),
    shrink: Annotated[int, typer.Option(help="Trials to shrink a failing script; 0 leaves it as it is.")] = 300,
    repeat: Annotated[Path | None, typer.Option(help="Run one script again, from its file.")] = None,
    full: Annotated[
        bool, typer.Option("--full", help="Run with fidelity full in a scenario, instead of points.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Run random fault scripts on the coordination code, judge them, and shrink scripts that break an invariant."""
    from robrain.deploy.command_line.options import above_zero
    from robrain.deploy.errors import UsageError

    for name, value, least in (("--runs", runs, 1), ("--jobs", jobs, 1), ("--seed", seed, 0), ("--shrink", shrink, 0)):
        if value is not None and value < least:
            raise UsageError(f"{name} {value}: expected at least {least}")
    above_zero("--minutes", minutes)
    if full and repeat is not None:
        raise UsageError("--full: expected no --repeat with it; a script says what it is run with")
    if repeat is not None:
        _repeat(repeat, as_json=as_json)
        return

    from robrain.lab.soak.soak_display import show_soak, soak_display
    from robrain.lab.soak.soaking import SoakOptions
    from robrain.lab.soak.soaking import soak as run_soak
    from robrain.lab.sweep.sweep import cores

    count = runs or 100
    options = SoakOptions(
        seeds=range(seed, seed + count),
        jobs=jobs or cores(),
        minutes=minutes,
        output=output,
        trials_max=shrink,
        is_full=full,
        quiet=as_json,
    )
    with soak_display(count, quiet=as_json) as show:
        result = run_soak(options, show)
    print_either(result, lambda: show_soak(result), as_json=as_json)
    if result.interrupted:
        raise typer.Exit(INTERRUPTED)
    if result.failures or result.errors:
        raise typer.Exit(BROKEN)


def _repeat(file: Path, *, as_json: bool) -> None:
    from robrain.deploy.processes.kernels import prepare_kernels
    from robrain.lab.soak.fault_script import read_script
    from robrain.lab.soak.soak_display import show_script
    from robrain.lab.soak.soaking import run_script

    script = read_script(file)
    prepare_kernels(quiet=as_json)
    verdict = run_script(script)
    print_either(verdict, lambda: show_script(script, verdict), as_json=as_json)
    if verdict.broken:
        raise typer.Exit(BROKEN)
