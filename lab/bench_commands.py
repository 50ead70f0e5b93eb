"""`robrain bench`: measurements that anybody can repeat, each figure beside the bound that it is to keep."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from robrain.deploy.command_line.scenario_options import NearOption
from robrain.deploy.command_line.team_options import JsonOption

BENCHES = {
    "allocation": "task allocation: gaps to exact optima, times of first plans, public routing instances",
    "consensus": "task allocation without a coordinator: gaps to optimal, messages, lost messages",
    "responses": "response times from an event to the wheels, of a live team of processes on loopback",
    "agents": "cost of a thousand simulated agents at 10 Hz for a coordinator",
    "exploration": "exploration strategies and team sizes on map files: the full stack beside ideal motion",
    "leaderless": "exploration whose coordinator is killed on the way, beside the same undisturbed",
    "motes": "lifetime of a mote field: routes beside their bound, robots as mules beside a collection tree",
    "mapping": "accuracy of maps and positions: teams explore map files in lockstep",
    "joining": "robots with unknown places: time and errors of joining the team's map",
    "live": "accuracy of the map of a live team whose agents are stopped at random times",
    "log": "accuracy of a trajectory: a public lidar log through localisation and mapper",
}
"""Name, and what it measures."""

bench_app = typer.Typer(
    name="bench", help="Run benchmarks; each figure is shown beside its bound.", rich_markup_mode=None
)

MapsOption = Annotated[
    str | None, typer.Option(help="Names or paths of maps, or built-in scenarios, separated by commas; default: all.")
]
RobotsOption = Annotated[str, typer.Option(help="Numbers of robots, such as 1,4 or 1-4.")]
SeedsOption = Annotated[str, typer.Option(help="Seeds, such as 1,2 or 1-8.")]
WheelsOption = Annotated[str, typer.Option(help="exact, slipping (also 1 % off), or both.")]
JobsOption = Annotated[int, typer.Option(help="Number of parallel runs, each in a process of its own.")]
TimeLimitOption = Annotated[float, typer.Option(help="Simulated seconds after which a run ends.")]
MapFolderOption = Annotated[
    Path | None, typer.Option(help="Folder of the maps that are not part of the project; default: ../shared/maps.")
]
JsonFileOption = Annotated[Path | None, typer.Option("--json", help="Write runs and figures to this file.")]
SecondsOption = Annotated[float, typer.Option(help="With --instance: seconds of CPU time for the search.")]


@bench_app.callback(invoke_without_command=True)
def benches(
    context: typer.Context, names: Annotated[bool, typer.Option("--list", help="List the benchmarks.")] = False
) -> None:
    """Run benchmarks; each figure is shown beside its bound."""
    if names:
        for name, what in BENCHES.items():
            sys.stdout.write(f"{name:<12}{what}\n")
    elif context.invoked_subcommand is None:
        sys.stdout.write(context.get_help() + "\n")


@bench_app.command(help=BENCHES["allocation"])
def allocation(
    instance: Annotated[
        Path | None, typer.Option(help="Solve this public instance instead: VRPLIB .vrp, or Solomon .txt.")
    ] = None,
    best: Annotated[
        float | None,
        typer.Option(help="With --instance: best known value; default: the Cost of the .sol file beside it."),
    ] = None,
    seconds: SecondsOption = 5.0,
    seed: Annotated[int, typer.Option(help="With --instance: seed of the search.")] = 0,
    sizes: Annotated[
        int, typer.Option(help="Without --instance: how many of the sizes 5 × 50, 20 × 200, 100 × 1000.")
    ] = 3,
    as_json: JsonOption = False,
) -> None:
    """Measure the allocators."""
    from robrain.deploy.errors import UsageError
    from robrain.lab.bench.allocation.allocation import SIZES, measure

    if instance is not None:
        _solve(instance, best, seconds, seed, as_json=as_json)
        return
    if best is not None:
        raise UsageError("--best: expected together with --instance FILE")
    if sizes not in range(1, len(SIZES) + 1):
        raise UsageError(f"--sizes {sizes}: expected 1 to {len(SIZES)}")
    from robrain.lab.bench.figure import report

    report("allocation", measure(SIZES[:sizes]), as_json=as_json)


@bench_app.command(help=BENCHES["consensus"])
def consensus(
    sizes: Annotated[int, typer.Option(help="How many of the sizes 5 × 50, 10 × 100.")] = 2,
    seeds: Annotated[int, typer.Option(help="Number of problems of 5 × 50; three tenths of it of 10 × 100.")] = 10,
    as_json: JsonOption = False,
) -> None:
    """Measure allocation by consensus."""
    from robrain.deploy.errors import UsageError
    from robrain.lab.bench.allocation.consensus import SIZES, measure
    from robrain.lab.bench.figure import report

    if sizes not in range(1, len(SIZES) + 1):
        raise UsageError(f"--sizes {sizes}: expected 1 to {len(SIZES)}")
    _at_least("--seeds", seeds, 1)
    report("consensus", measure(SIZES[:sizes], range(1, seeds + 1)), as_json=as_json)


@bench_app.command(help=BENCHES["responses"])
def responses(
    rounds: Annotated[int, typer.Option(help="Repetitions of each event; one or two seconds each.")] = 100,
    as_json: JsonOption = False,
) -> None:
    """Measure response times."""
    from robrain.lab.bench.figure import report
    from robrain.lab.bench.responses import measure

    _at_least("--rounds", rounds, 1)
    report("responses", measure(rounds), as_json=as_json)


@bench_app.command(help=BENCHES["agents"])
def agents(
    robots: Annotated[int, typer.Option(help="Number of agents.")] = 1000,
    minutes: Annotated[
        float, typer.Option(help="Duration of the measurement; growth of memory is measured from 5 minutes on.")
    ] = 10.0,
    as_json: JsonOption = False,
) -> None:
    """Measure what many agents cost."""
    from robrain.deploy.errors import UsageError
    from robrain.lab.bench.agents import measure
    from robrain.lab.bench.figure import report

    _at_least("--robots", robots, 1)
    if not minutes > 0:
        raise UsageError(f"--minutes {minutes:g}: expected a number above 0")
    report("agents", measure(robots, minutes), as_json=as_json)


@bench_app.command(help=BENCHES["mapping"])
def mapping(
    maps: MapsOption = None,
    robots: RobotsOption = "1,2,4,8,16",
    seeds: SeedsOption = "1-3",
    wheels: WheelsOption = "exact,slipping",
    conditions: Annotated[
        str, typer.Option(help="usual, glass (and mirrors), late (messages, paused agents), or several.")
    ] = "usual",
    jobs: JobsOption = 1,
    time_limit_s: TimeLimitOption = 240.0,
    map_folder: MapFolderOption = None,
    json_file: JsonFileOption = None,
) -> None:
    """Measure the accuracy of maps and positions."""
    from robrain.lab.bench.mapping.mapping import run_bench
    from robrain.lab.bench.mapping_plan import choose

    run_bench(choose(maps, robots, seeds, wheels, jobs, time_limit_s, map_folder, conditions), json_file)


@bench_app.command(help=BENCHES["exploration"])
def exploration(
    maps: MapsOption = None,
    robots: RobotsOption = "1,2,4,8",
    seeds: SeedsOption = "1-10",
    strategies: Annotated[
        str | None,
        typer.Option(help="Names of exploration strategies, or FILE.py:NAME, separated by commas; default: all."),
    ] = None,
    motion: Annotated[
        str, typer.Option(help="full (the whole stack), ideal (points at top speed, exact poses), or both.")
    ] = "full,ideal",
    near: NearOption = None,
    sight: Annotated[
        bool,
        typer.Option("--sight", help="Also compute how soon robots that know the floor could have seen 95 %."),
    ] = False,
    jobs: JobsOption = 1,
    time_limit_s: TimeLimitOption = 900.0,
    map_folder: MapFolderOption = None,
    json_file: JsonFileOption = None,
    page: Annotated[
        Path | None,
        typer.Option("--page", help="Markdown page whose tables of times are replaced, or a new one."),
    ] = None,
) -> None:
    """Compare exploration strategies."""
    from robrain.deploy.command_line.options import place_of
    from robrain.lab.bench.exploration import choose, run_bench

    around = place_of("--near", near)
    place = None if around is None else (around.x_m, around.y_m)
    plan = choose(maps, robots, seeds, strategies, motion, place, jobs, time_limit_s, map_folder, with_sight=sight)
    run_bench(plan, json_file, page)


@bench_app.command(help=BENCHES["leaderless"])
def leaderless(
    maps: Annotated[
        str, typer.Option(help="Names or paths of maps, or built-in scenarios, separated by commas.")
    ] = "depot,office,hospital",
    robots: RobotsOption = "4",
    seeds: SeedsOption = "1-4",
    killed_at: Annotated[
        float, typer.Option(help="Percentage of the floor known when the coordinator is killed.")
    ] = 30,
    jobs: JobsOption = 1,
    time_limit_s: TimeLimitOption = 900.0,
    map_folder: MapFolderOption = None,
    json_file: JsonFileOption = None,
) -> None:
    """Measure exploration without a coordinator."""
    from robrain.lab.bench.leaderless import choose, run_bench

    run_bench(choose(maps, robots, seeds, killed_at, time_limit_s, map_folder), jobs, json_file)


@bench_app.command(help=BENCHES["motes"])
def motes(
    ways: Annotated[
        str | None, typer.Option(help="tree, routes, mules, relief, turns, or several; default: all.")
    ] = None,
    seeds: SeedsOption = "1-10",
    count: Annotated[int, typer.Option("--motes", help="Number of motes on 100 × 100 m.")] = 100,
    tours_per_day: Annotated[float, typer.Option(help="How often a robot collects.")] = 1.0,
    goal_days: Annotated[float, typer.Option(help="Lifetime that relief and turns aim at.")] = 330.0,
    jobs: JobsOption = 1,
    json_file: JsonFileOption = None,
) -> None:
    """Measure how long a mote field lives."""
    from robrain.lab.bench.motes import choose, run_bench

    run_bench(choose(ways, seeds, count, tours_per_day, goal_days, jobs), json_file)


@bench_app.command(help=BENCHES["joining"])
def joining(
    maps: MapsOption = None,
    robots: RobotsOption = "2",
    seeds: SeedsOption = "1-10",
    wheels: WheelsOption = "slipping",
    kinds: Annotated[str, typer.Option(help="unknown (starts), carried (off), or both.")] = "unknown,carried",
    jobs: JobsOption = 1,
    time_limit_s: TimeLimitOption = 180.0,
    map_folder: MapFolderOption = None,
    json_file: JsonFileOption = None,
) -> None:
    """Measure how robots that do not know their place join the team's map."""
    from robrain.lab.bench.mapping.joining import kinds_of, run_bench
    from robrain.lab.bench.mapping_plan import choose

    plan = choose(maps, robots, seeds, wheels, jobs, time_limit_s, map_folder)
    run_bench(plan, kinds_of(kinds), json_file)


@bench_app.command(help=BENCHES["live"])
def live(
    map_name: Annotated[
        str, typer.Option("--map", help="Path of a map.yaml, or a built-in scenario.")
    ] = "examples/maps/clinic.yaml",
    robots: Annotated[int, typer.Option(help="Number of robots.")] = 4,
    seed: Annotated[int, typer.Option(help="Seed of all random numbers.")] = 1,
    minutes: Annotated[float, typer.Option(help="Duration of each of the two runs.")] = 15.0,
    as_json: JsonOption = False,
) -> None:
    """Measure what stopped agents do to the map."""
    from robrain.deploy.errors import UsageError
    from robrain.lab.bench.figure import report
    from robrain.lab.bench.mapping.live_mapping import measure
    from robrain.sim.scenarios.scenario import Scenario

    if not 0 < minutes < float("inf"):
        raise UsageError(f"--minutes {minutes:g}: expected a number above 0")
    is_map = map_name.endswith(".yaml")
    scenario = Scenario.from_map(map_name) if is_map else Scenario.builtin(map_name)
    options = ["--robots", str(robots), "--seed", str(seed)]
    argument = ["--map", map_name, *options] if is_map else [map_name, *options]
    report("live", measure(scenario.replace(robots=robots, seed=seed), argument, minutes), as_json=as_json)


@bench_app.command(help=f"{BENCHES['log']}; logs in the format of CARMEN (FLASER, ROBOTLASER1, ODOM).")
def log(
    log_file: Annotated[Path, typer.Argument(metavar="LOG", help="The log; it is not part of robrain.")],
    relations: Annotated[
        Path | None,
        typer.Option(help="File of lines t1 t2 x y z roll pitch yaw: known relations between poses of the log."),
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures to this file.")] = None,
    map_file: Annotated[
        Path | None, typer.Option("--map", help="Write the map in ROS map_server format, OUT.yaml and OUT.pgm.")
    ] = None,
    robot_file: Annotated[
        Path | None,
        typer.Option("--robot", help="ROBOT.toml with parameters of driver (odometry), localisation and mapper."),
    ] = None,
) -> None:
    """Measure a trajectory on a public log."""
    from robrain.lab.log_bench.bench import run_bench

    run_bench(log_file, relations, json_file, map_file, robot_file)


def _at_least(option: str, value: int, least: int) -> None:
    from robrain.deploy.errors import UsageError

    if value < least:
        raise UsageError(f"{option} {value}: expected at least {least}")


def _solve(path: Path, best: float | None, seconds: float, seed: int, *, as_json: bool) -> None:
    import time

    import msgspec

    from robrain.algorithms.allocation.optimal import OptimalAllocator
    from robrain.algorithms.allocation.problem import Objective
    from robrain.algorithms.allocation.warm_up import warm_up
    from robrain.deploy.errors import UsageError
    from robrain.lab.bench.allocation.public import read_best, read_public, solve_public

    if seconds <= 0:
        raise UsageError(f"--seconds {seconds:g}: expected a number above 0")
    if best is not None and best <= 0:
        raise UsageError(f"--best {best:g}: expected a number above 0")
    public = read_public(path)
    known = best if best is not None else read_best(path)
    warm_up()
    allocator = OptimalAllocator(Objective.ENERGY, time.process_time)
    result = solve_public(public, allocator, known, deadline_s=seconds, seed=seed)
    if as_json:
        sys.stdout.write(msgspec.json.encode(result).decode() + "\n")
        return
    sys.stdout.write(f"{result.instance}: {result.customers} customers, {result.vehicles} vehicles used\n")
    sys.stdout.write(f"value {result.value:g}, best known {'–' if known is None else f'{known:g}'}")
    sys.stdout.write("\n" if result.gap is None else f", gap {100 * result.gap:.2f} %\n")
    if result.note:
        sys.stdout.write(f"note: {result.note}\n")
