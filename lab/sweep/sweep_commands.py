"""The command for sweeps. It reads its options and calls the code that does the work."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from robrain.deploy.command_line.command_group import SIMULATE, CommandApp
from robrain.deploy.command_line.options import (
    JsonOption,
    MapOption,
    MotesOption,
    RobotsOption,
    ScenarioArgument,
    TimeLimitOption,
    UntilOption,
)
from robrain.deploy.command_line.output import print_either

sweep_app = CommandApp(SIMULATE)

FAILED = 1
"""Exit status if runs failed."""
INTERRUPTED = 130


@sweep_app.command()
def sweep(
    scenario: ScenarioArgument = None,
    map_file: MapOption = None,
    robots: RobotsOption = None,
    motes: MotesOption = None,
    seeds: Annotated[str, typer.Option(help="Seeds of each setting: 1..30, or 1,4,9.")] = "1..10",
    vary: Annotated[
        list[str] | None,
        typer.Option(
            help="Values of a key: robots=1,2,4. Several options combine. Keys: robots, motes, map, strategy, method, "
            "objective, until, time_limit, or TABLE.KEY of a scenario file."
        ),
    ] = None,
    until: UntilOption = None,
    time_limit: TimeLimitOption = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder to write to; default: runs/SCENARIO-sweep.")
    ] = None,
    workers: Annotated[int | None, typer.Option(help="Number of processes; default: one for each core.")] = None,
    dask: Annotated[
        str | None, typer.Option(help="Run on a Dask cluster: address of its scheduler, such as tcp://host:8786.")
    ] = None,
    record: Annotated[bool, typer.Option("--record", help="Record each run below recordings/.")] = False,
    limit: Annotated[int, typer.Option(help="Greatest number of runs.")] = 1000,
    as_json: JsonOption = False,
) -> None:
    """Run a scenario with many seeds and settings on all cores; the same command continues a sweep."""
    from robrain.deploy.command_line.options import above_zero, until_explored
    from robrain.deploy.command_line.scenario_choice import choose_scenario
    from robrain.deploy.errors import UsageError
    from robrain.lab.sweep.plan import make_plan, read_seeds, read_vary
    from robrain.lab.sweep.sweep import SweepOptions, run_sweep
    from robrain.lab.sweep.sweep_display import show_sweep, sweep_display

    if limit < 1:
        raise UsageError(f"--limit {limit}: expected at least 1")
    chosen = choose_scenario(scenario, map_file, robots, motes, None)
    ends = {"until_explored": until_explored(until), "time_limit_s": above_zero("--time-limit", time_limit)}
    chosen = chosen.replace(**{name: value for name, value in ends.items() if value is not None})
    plan = make_plan(chosen, read_seeds(seeds), read_vary(vary or []), limit=limit)
    options = SweepOptions(
        output=output if output is not None else Path("runs") / f"{chosen.name}-sweep",
        workers=workers,
        dask=dask,
        record=record,
        command=("robrain", *sys.argv[1:]),
        quiet=as_json,
    )
    with sweep_display(plan, quiet=as_json) as show:
        result = run_sweep(plan, options, show)
    print_either(result, lambda: show_sweep(result), as_json=as_json)
    if result.interrupted:
        raise typer.Exit(INTERRUPTED)
    if result.errors:
        raise typer.Exit(FAILED)
