"""`robrain bench`: measurements that anybody can repeat, each figure beside the bound that it is to keep."""

from pathlib import Path
from typing import Annotated

import typer

from robrain.deploy.command_line.command_group import SIMULATE, CommandApp
from robrain.deploy.command_line.options import NearOption

bench_app = CommandApp(SIMULATE, "bench", "Run benchmarks; each figure is shown beside its bound.")

MapsOption = Annotated[
    str | None, typer.Option(help="Names or paths of maps, or built-in scenarios, separated by commas; default: all.")
]
RobotsOption = Annotated[str, typer.Option(help="Numbers of robots, such as 1,4 or 1-4.")]
SeedsOption = Annotated[str, typer.Option(help="Seeds, such as 1,2 or 1-8.")]
WheelsOption = Annotated[str, typer.Option(help="exact, slipping (also 1 % off), or both.")]
JobsOption = Annotated[int, typer.Option(help="Number of parallel runs, each in a separate process.")]
TimeLimitOption = Annotated[float, typer.Option(help="Simulated seconds after which a run ends.")]
MapFolderOption = Annotated[
    Path | None, typer.Option(help="Folder of the maps that are not part of the project; default: ../shared/maps.")
]
JsonFileOption = Annotated[Path | None, typer.Option("--json", help="Write runs and figures to this file.")]


@bench_app.command()
def allocation(
    instances: Annotated[
        list[Path],
        typer.Argument(
            metavar="FOLDER|FILES", help="Public instances: VRPLIB, Solomon, Homberger, Li and Lim, or Schneider."
        ),
    ],
    seconds: Annotated[float, typer.Option(help="Seconds of CPU time for each search.")] = 5.0,
    seed: Annotated[int, typer.Option(help="Seed of the search.")] = 0,
    json_file: JsonFileOption = None,
) -> None:
    """Measure the gap of task allocation to best known solutions of public routing instances, beside PyVRP alone."""
    from robrain.lab.bench.allocation import choose, run_bench

    run_bench(choose(instances, seconds, seed), json_file)


@bench_app.command()
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
    """Measure the accuracy of maps and positions: teams explore map files in lockstep."""
    from robrain.lab.bench.mapping import run_bench
    from robrain.lab.bench.mapping_plan import choose

    run_bench(choose(maps, robots, seeds, wheels, jobs, time_limit_s, map_folder, conditions), json_file)


@bench_app.command()
def exploration(
    maps: MapsOption = None,
    robots: RobotsOption = "1,2,4,8",
    seeds: SeedsOption = "1-10",
    strategies: Annotated[
        str | None,
        typer.Option(help="Names of exploration strategies, or FILE.py:NAME, separated by commas; default: all."),
    ] = None,
    motion: Annotated[str, typer.Option(help="Fidelities: full, points, or both.")] = "full,points",
    near: NearOption = None,
    sight: Annotated[
        bool,
        typer.Option("--sight", help="Also compute how soon robots that know the floor could have seen 95 %."),
    ] = False,
    jobs: JobsOption = 1,
    time_limit_s: TimeLimitOption = 900.0,
    map_folder: MapFolderOption = None,
    json_file: JsonFileOption = None,
) -> None:
    """Compare exploration strategies and team sizes on map files: full runs beside points."""
    from robrain.deploy.command_line.options import point
    from robrain.lab.bench.exploration import choose, run_bench

    place = None if near is None else point("--near", near)
    plan = choose(maps, robots, seeds, strategies, motion, place, jobs, time_limit_s, map_folder, with_sight=sight)
    run_bench(plan, json_file)


@bench_app.command()
def motes(
    methods: Annotated[
        str | None, typer.Option(help="tree, routes, mules, relief, turns, or several; default: all.")
    ] = None,
    seeds: SeedsOption = "1-10",
    count: Annotated[int, typer.Option("--motes", help="Number of motes on 100 × 100 m.")] = 100,
    tours_per_day: Annotated[float, typer.Option(help="How often a robot collects.")] = 1.0,
    goal_days: Annotated[float, typer.Option(help="Lifetime that relief and turns aim at.")] = 330.0,
    jobs: JobsOption = 1,
    json_file: JsonFileOption = None,
) -> None:
    """Measure the lifetime of a mote field: routes beside their bound, robots beside a collection tree."""
    from robrain.lab.bench.motes import choose, run_bench

    run_bench(choose(methods, seeds, count, tours_per_day, goal_days, jobs), json_file)


@bench_app.command()
def estimates(
    scenarios: Annotated[str, typer.Option(help="Built-in scenarios, separated by commas.")] = "depot,office,hospital",
    robots: RobotsOption = "4,8",
    seeds: SeedsOption = "105-106",
    tasks: Annotated[int, typer.Option(help="Number of tasks in each run.", min=1)] = 42,
    connect: Annotated[str | None, typer.Option(help="Endpoint of a live team on this floor, tcp/HOST:PORT.")] = None,
    jobs: JobsOption = 1,
    json_file: JsonFileOption = None,
) -> None:
    """Measure the accuracy of estimates: predicted ends and energies of tasks beside the real ones."""
    from robrain.lab.bench.estimates import choose, run_bench

    run_bench(choose(scenarios, robots, seeds, tasks, jobs, connect), json_file)


@bench_app.command()
def traffic(
    floors: Annotated[
        str, typer.Option(help="Floors, separated by commas: swap, lane, crossing, dead_end, random.")
    ] = "swap,lane,crossing,dead_end,random",
    seeds: SeedsOption = "1-3",
    jobs: JobsOption = 1,
    time_limit_s: TimeLimitOption = 3600.0,
    json_file: JsonFileOption = None,
) -> None:
    """Measure dense traffic: waits, contacts and throughput of robots in narrow places, without and with faults."""
    from robrain.lab.bench.traffic import choose, run_bench

    run_bench(choose(floors, seeds, jobs, time_limit_s), json_file)


@bench_app.command()
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
    """Measure the accuracy of a trajectory on a lidar log in the format of CARMEN (FLASER, ROBOTLASER1, ODOM)."""
    from robrain.lab.bench.log_bench import run_bench

    run_bench(log_file, relations, json_file, map_file, robot_file)
