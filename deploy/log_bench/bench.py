"""`robrain bench log`: how right a robot's trajectory is on a public lidar log, beside what others have published."""

from itertools import pairwise
from pathlib import Path

import msgspec
from rich.table import Table

from robrain.deploy.bench.figure import WIDTH, write_json
from robrain.deploy.commands.terminal import new_console, print_line
from robrain.deploy.errors import UsageError
from robrain.deploy.log_bench.carmen_log import CarmenLog, read_carmen_log
from robrain.deploy.log_bench.played_log import Parameters, PlayedLog, play
from robrain.deploy.log_bench.relations import (
    LOOP_S,
    Relation,
    RelativeErrors,
    read_relations,
    relations_between,
    relative_errors,
)
from robrain.protocol.model.geometry import Pose2D


class Published(msgspec.Struct, frozen=True):
    """What others have published for the whole log and its whole file of relations."""

    log: str
    method: str
    errors: str


PUBLISHED = (
    Published("MIT CSAIL", "Cartographer (Hess et al. 2016)", "0.0319 ± 0.0363 m, 0.369 ± 0.365°"),
    Published("MIT CSAIL", "RBPF, GMapping (Kümmerle et al. 2009)", "0.049 ± 0.049 m"),
    Published("Intel Research Lab", "Cartographer (Hess et al. 2016)", "0.0229 ± 0.0239 m, 0.453 ± 1.335°"),
    Published("Intel Research Lab", "RBPF, GMapping (Kümmerle et al. 2009)", "0.070 ± 0.083 m"),
    Published("Freiburg 079", "Cartographer (Hess et al. 2016)", "0.0452 ± 0.0354 m, 0.538 ± 0.718°"),
    Published("Freiburg 079", "RBPF, GMapping (Kümmerle et al. 2009)", "0.061 ± 0.044 m"),
)


class Scored(msgspec.Struct, frozen=True, kw_only=True):
    """Errors of one trajectory."""

    trajectory: str
    all: RelativeErrors
    loops: RelativeErrors | None
    """Over relations of more than `LOOP_S` alone."""


class LogReport(msgspec.Struct, frozen=True, kw_only=True):
    """What `--json` writes."""

    bench: str
    log: str
    scans: int
    duration_s: float
    way_m: float
    """By odometry."""
    lost: int
    """Scans during which the robot said that it is lost."""
    left_out: int
    """Scans that were not mapped."""
    submaps: int
    closures: int
    contradictions: int
    relations: int
    relations_unused: int
    """Those one of whose stamps is no scan's."""
    errors: list[Scored]


def run_bench(
    log_file: Path,
    relations_file: Path | None = None,
    json_file: Path | None = None,
    map_file: Path | None = None,
    robot_file: Path | None = None,
) -> None:
    """Play a log; print what became of it.

    Args:
        log_file: in the format of CARMEN.
        relations_file: what is known of pairs of its poses; without it errors are not told.
        json_file: gets the figures as well.
        map_file: YAML file for the map, which does not exist yet; the picture has its name with `.pgm`.
        robot_file: ROBOT.toml whose parameters of `driver` (`odometry`), `localisation` and `mapper` are taken.

    Raises:
        LogError: the log or the relations cannot be read.
        RobotFileError: `robot_file` cannot be read.
        UsageError: a file cannot be written.

    """
    parameters = _parameters(robot_file)
    log = read_carmen_log(log_file)
    relations = read_relations(relations_file) if relations_file is not None else []
    matching = relations_between([entry.stamp_s for entry in log.entries if entry.scan is not None], relations)
    if relations and not matching:
        raise UsageError(f"--relations {relations_file}: no two stamps of a relation are those of scans in {log_file}")
    _check_free(map_file)
    print_line(f"{log.name}: {log.scans} scans in {log.duration_s:.0f} s")
    played = play(log, parameters)
    report = made_report(log, played, relations, matching)
    _show(report)
    if json_file is not None:
        write_json(json_file, report)
    if map_file is not None:
        _write_map(map_file, played)


def made_report(
    log: CarmenLog, played: PlayedLog, relations: list[Relation], matching: list[tuple[int, int, Relation]]
) -> LogReport:
    """The figures of a log that was played; `matching` are those of the relations that are between its scans."""
    trajectories = {
        "odometry alone": played.odometry,
        "as the robot told it": played.told,
        "after all loop closures": played.poses,
    }
    return LogReport(
        bench="log",
        log=log.name,
        scans=log.scans,
        duration_s=log.duration_s,
        way_m=_way_m(played.odometry),
        lost=played.lost,
        left_out=played.counters.scans_left_out,
        submaps=played.counters.submaps,
        closures=played.counters.closures,
        contradictions=played.counters.contradictions,
        relations=len(relations),
        relations_unused=len(relations) - len(matching),
        errors=[
            Scored(trajectory=name, all=errors, loops=relative_errors(poses, matching, LOOP_S))
            for name, poses in trajectories.items()
            if (errors := relative_errors(poses, matching)) is not None
        ],
    )


def _show(report: LogReport) -> None:
    print_line(
        f"way by odometry {report.way_m:.0f} m; lost during {report.lost} scans, {report.left_out} not mapped; "
        f"{report.submaps} submaps, {report.closures} loop closures, {report.contradictions} contradictions"
    )
    if not report.errors:
        return
    used = report.relations - report.relations_unused
    title = f"errors over {used} of {report.relations} relations, mean ± standard deviation"
    table = Table(title=title, title_justify="left")
    for heading in ("trajectory", "all relations", f"those over more than {LOOP_S:g} s"):
        table.add_column(heading)
    for each in report.errors:
        table.add_row(each.trajectory, _words(each.all), "–" if each.loops is None else _words(each.loops))
    console = new_console(width=WIDTH)
    console.print(table)
    beside = Table(title="published for whole logs, all relations", title_justify="left")
    for heading in ("log", "method", "errors"):
        beside.add_column(heading)
    for published in PUBLISHED:
        beside.add_row(published.log, published.method, published.errors)
    console.print(beside)


def _words(errors: RelativeErrors) -> str:
    return (
        f"{errors.mean_m:.4f} ± {errors.sigma_m:.4f} m, {errors.mean_deg:.3f} ± {errors.sigma_deg:.3f}° "
        f"({errors.relations})"
    )


def _way_m(poses: list[Pose2D]) -> float:
    return sum(before.distance_m(after) for before, after in pairwise(poses))


def _parameters(robot_file: Path | None) -> Parameters:
    if robot_file is None:
        return {}
    from robrain.agent.host.robot_file import read_robot_file

    found = read_robot_file(robot_file).parameters
    return {name: found[name] for name in ("driver", "localisation", "mapper") if name in found}


def _check_free(map_file: Path | None) -> None:
    """Before an hour of work, not after it."""
    if map_file is None:
        return
    for path in (map_file, map_file.with_suffix(".pgm")):
        if path.exists():
            raise UsageError(f"--map {path}: exists already; give another name or move it away")


def _write_map(path: Path, played: PlayedLog) -> None:
    from robrain.coordinator.recording.export.map_server_files import write_grid

    try:
        for written in write_grid(played.map, path):
            print_line(f"wrote {written}")
    except OSError as error:
        raise UsageError(f"--map {path}: cannot be written: {error.strerror or error}") from error
