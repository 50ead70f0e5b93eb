"""`robrain bench log`: how right a robot's trajectory is on a public lidar log, beside what others have published."""

import bisect
import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import msgspec
from rich.table import Table

from robrain.deploy.commands.terminal import new_console, print_line
from robrain.deploy.errors import LogError, UsageError
from robrain.lab.bench.figure import WIDTH, write_json
from robrain.lab.log_bench.carmen_log import (
    PLACE_MAX_M,
    STAMP_MAX_S,
    CarmenLog,
    number_of,
    numbered_lines,
    read_carmen_log,
)
from robrain.lab.log_bench.played_log import Parameters, PlayedLog, play
from robrain.protocol.model.geometry import Pose2D

SAME_S = 5e-4
"""A stamp of a relation is that of the scan that is so near."""
LOOP_S = 5.0
"""Relations over more time than this are told on their own as well: of those the odometry says little."""


class Relation(msgspec.Struct, frozen=True):
    """Where the robot was at `to_s`, seen from where it was at `from_s`; seconds of the log's clock."""

    from_s: float
    to_s: float
    pose: Pose2D


class RelativeErrors(msgspec.Struct, frozen=True, kw_only=True):
    """Mean and standard deviation of absolute errors over relations."""

    relations: int
    mean_m: float
    sigma_m: float
    mean_deg: float
    sigma_deg: float


def read_relations(path: Path) -> list[Relation]:
    """Read a file of relations, lines of `t1 t2 x y z roll pitch yaw`.

    Raises:
        LogError: the file cannot be read, is too large, a line is wrong, or there is no relation in it.

    """
    relations = []
    for number, line in numbered_lines(path):
        words = line.split()
        try:
            if len(words) != 8:
                raise ValueError(f"expected t1 t2 x y z roll pitch yaw, got {len(words)} words")
            from_s, to_s = (number_of(word, 0.0, STAMP_MAX_S) for word in words[:2])
            x_m, y_m, _, _, _, yaw_rad = (number_of(word, -PLACE_MAX_M, PLACE_MAX_M) for word in words[2:])
        except ValueError as error:
            raise LogError(f"{path}: line {number}: {error}") from error
        relations.append(Relation(from_s, to_s, Pose2D(x_m, y_m, math.remainder(yaw_rad, math.tau))))
    if not relations:
        raise LogError(f"{path}: expected relations, lines of t1 t2 x y z roll pitch yaw; there are none")
    return relations


def relations_between(stamps_s: Sequence[float], relations: Sequence[Relation]) -> list[tuple[int, int, Relation]]:
    """Those relations both of whose stamps are a scan's, with the indices of the scans; stamps ascend."""
    found = []
    for relation in relations:
        first, second = _index(stamps_s, relation.from_s), _index(stamps_s, relation.to_s)
        if first is not None and second is not None:
            found.append((first, second, relation))
    return found


def relative_errors(
    poses: Sequence[Pose2D], relations: Sequence[tuple[int, int, Relation]], over_s: float = 0.0
) -> RelativeErrors | None:
    """Errors of a trajectory over relations of more than `over_s`; None if there is none of these.

    Args:
        poses: of the scans, in any one frame.
        relations: as `relations_between` gives them.
        over_s: relations over less time do not count.

    """
    errors_m, errors_deg = [], []
    for first, second, relation in relations:
        if abs(relation.to_s - relation.from_s) < over_s:
            continue
        found = poses[first].inverse().compose(poses[second])
        errors_m.append(found.distance_m(relation.pose))
        errors_deg.append(math.degrees(abs(math.remainder(found.yaw_rad - relation.pose.yaw_rad, math.tau))))
    if not errors_m:
        return None
    mean_m, sigma_m = _spread(errors_m)
    mean_deg, sigma_deg = _spread(errors_deg)
    return RelativeErrors(
        relations=len(errors_m), mean_m=mean_m, sigma_m=sigma_m, mean_deg=mean_deg, sigma_deg=sigma_deg
    )


def _index(stamps_s: Sequence[float], stamp_s: float) -> int | None:
    at = bisect.bisect_left(stamps_s, stamp_s)
    near = min((i for i in (at - 1, at) if 0 <= i < len(stamps_s)), key=lambda i: abs(stamps_s[i] - stamp_s))
    return near if abs(stamps_s[near] - stamp_s) <= SAME_S else None


def _spread(values: Sequence[float]) -> tuple[float, float]:
    mean = math.fsum(values) / len(values)
    return mean, math.sqrt(math.fsum((value - mean) ** 2 for value in values) / len(values))


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
        UsageError: the relations do not fit the log, or the file of the map exists.

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
    from robrain.recording.export.map_server_files import write_grid

    for written in write_grid(played.map, path):
        print_line(f"wrote {written}")
