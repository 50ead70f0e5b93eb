"""The headline's dot: the worst of robots, coordinator, localisation, map and lateness.

Map and positions are compared with the ground truth if an arena publishes it. Otherwise they are judged by the robots'
`map_agreement`. It is weaker: a map that is wrong everywhere agrees with the scans that it was made from.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple

from robrain.algorithms.localization.pose_accuracy import position_sigma_m
from robrain.dashboard.state.shown_robot import RobotContact, RobotHealth
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.model.accuracy import MapAccuracy

UNSURE_M, ASTRAY_M = 0.5, 2.0
"""Standard deviation above which a position is uncertain, and above which it is useless."""
LATE_S, VERY_LATE_S = 1.0, 3.0
"""Maximum ages of states (sent at 10 Hz) before a warning and an error; `SUMMARY_S` is added for summaries (2 Hz)."""
SUMMARY_S = 0.5
MAPLESS_S = 10.0
"""Robots that have been up for this long should have sent map patches."""
MAP_OFF, MAP_FAR_OFF = 0.02, 0.05
"""Share of occupied cells off the true walls above which the map is amber, and red."""
MAP_CELLS_MIN = 100
"""Least number of occupied cells of a map that is judged: a share of fewer cells is mostly chance."""
AGREES, HARDLY_AGREES = 0.7, 0.5
"""Share of a robot's beams that agree with its map below which the robot is amber, and red. With a right map the median
is 95 %, and the least value 73 %, in the first seconds."""
REFUSED_S = 10.0
"""Time for which a rejected map patch stays in the headline."""


class Grade(IntEnum):
    """Severity of a finding; the highest one sets the dot."""

    GOOD = 0
    WARN = 1
    BAD = 2


class HeadlineProblem(NamedTuple):
    """One problem."""

    grade: Grade
    words: str


class Headline(NamedTuple):
    """Grade of the dot, and the problems other than the robots' own conditions."""

    grade: Grade
    findings: tuple[HeadlineProblem, ...] = ()


@dataclass(frozen=True)
class Vitals:
    """The inputs of the headline."""

    conditions: Mapping[RobotHealth, int] = field(default_factory=dict)
    """Number of robots in each condition."""
    connected: bool = True
    halted: bool = False
    """Whether a team-wide halt is in force, acknowledged or not."""
    coordinator_up: bool | None = None
    """None if unknown, as in a recording."""
    worst_sigma_m: float = math.nan
    """Greatest position uncertainty (1 σ) of a robot in contact; NaN if no robot reports one."""
    worst_sigma_robot: str = ""
    map_missing: bool = False
    """Robots have been up for `MAPLESS_S`, and no floor is known."""
    map_refused: bool = False
    """A map patch was rejected within the last `REFUSED_S`."""
    share_off: float = math.nan
    """Share of the map's occupied cells that are off the true walls; NaN without ground truth."""
    doubled_walls_m: float = 0.0
    """Length of walls that are on the map twice."""
    silent_robot: str = ""
    """Robot with the largest error that it does not report; empty if there is none."""
    silent_error_m: float = 0.0
    """Position error of that robot."""
    least_agreement: float = math.nan
    """Least share of a robot's beams that agree with its map; NaN with ground truth, and if no robot reports it."""
    least_agreement_robot: str = ""
    late_s: float = 0.0
    """Age of the oldest latest state or summary from a component in contact."""


ROBOT_GRADES: dict[RobotHealth, Grade] = {
    RobotHealth.UP: Grade.GOOD,
    RobotHealth.READY: Grade.GOOD,
    RobotHealth.OUT_OF_SERVICE: Grade.GOOD,
    RobotHealth.SILENT: Grade.WARN,
    RobotHealth.ASTRAY: Grade.BAD,
    RobotHealth.FAULTED: Grade.BAD,
    RobotHealth.HALTED: Grade.BAD,
    RobotHealth.LOST: Grade.BAD,
}


def headline_of(vitals: Vitals) -> Headline:
    """The worst grade of all, with its findings.

    >>> headline_of(Vitals({RobotHealth.UP: 2}, coordinator_up=False)).grade
    <Grade.BAD: 2>
    """
    robots = max((ROBOT_GRADES[one] for one, count in vitals.conditions.items() if count), default=Grade.GOOD)
    findings = tuple(_findings(vitals))
    return Headline(max([robots, *(finding.grade for finding in findings)]), findings)


def vitals_of(view: ShownTeam, now_s: float) -> Vitals:
    """The headline's inputs, from the team's view at `now_s`."""
    robots = [robot for robot in view.robots.values() if robot.contact(now_s) is RobotContact.UP]
    conditions = dict.fromkeys(RobotHealth, 0)
    for robot in view.robots.values():
        conditions[robot.condition(now_s)] += 1
    sigmas_m = [(position_sigma_m(robot.state.pose_covariance), robot.name) for robot in robots if robot.state]
    known_m = [(sigma_m, name) for sigma_m, name in sigmas_m if math.isfinite(sigma_m)]
    worst_m, worst_robot = max(known_m, default=(math.nan, ""))
    ages_s = [now_s - robot.last_seen_s for robot in robots if robot.last_seen_s is not None]
    if not view.is_replay and view.coordinator_up and view.team_seen_s is not None:
        ages_s.append(now_s - view.team_seen_s - SUMMARY_S)
    errors_m = [
        (robot.truth.accuracy.error_m or 0.0, robot.name)
        for robot in robots
        if robot.truth is not None and robot.truth.accuracy is not None and robot.truth.accuracy.silent_for_s > 0
    ]
    silent_error_m, silent_robot = max(errors_m, default=(0.0, ""))
    agreements = [(robot.state.map_agreement, robot.name) for robot in robots if robot.state]
    least, least_robot = min(
        ((agreement, name) for agreement, name in agreements if agreement is not None), default=(math.nan, "")
    )
    of_map = judged_map(view)
    first_s = min((robot.first_s for robot in robots if robot.first_s is not None), default=now_s)
    return Vitals(
        conditions=conditions,
        connected=view.connected,
        halted=view.halted,
        coordinator_up=view.coordinator_up if view.robots and not view.is_replay else None,
        worst_sigma_m=worst_m,
        worst_sigma_robot=worst_robot,
        map_missing=not view.is_replay and view.known_area_m2 <= 0 and now_s - first_s > MAPLESS_S,
        map_refused=view.map_refused_s is not None and now_s - view.map_refused_s <= REFUSED_S,
        share_off=math.nan if of_map is None else of_map.share_off,
        doubled_walls_m=0.0 if of_map is None else of_map.doubled_walls_m,
        silent_robot=silent_robot,
        silent_error_m=silent_error_m,
        least_agreement=math.nan if view.truth is not None else least,
        least_agreement_robot=least_robot,
        late_s=max(ages_s, default=0.0),
    )


def judged_map(view: ShownTeam) -> MapAccuracy | None:
    """Accuracy of the map by the ground truth; None without one, and for a map with too few cells."""
    known = view.truth.map_accuracy if view.truth is not None else None
    return known if known is not None and known.occupied_cells >= MAP_CELLS_MIN else None


def map_grade(share_off: float) -> Grade:
    """Grade of a map with this share of its occupied cells off the true walls."""
    return Grade.BAD if share_off > MAP_FAR_OFF else Grade.WARN if share_off > MAP_OFF else Grade.GOOD


def agreement_grade(agreement: float) -> Grade:
    """Grade of a robot with this share of beams that agree with its map."""
    return Grade.BAD if agreement < HARDLY_AGREES else Grade.WARN if agreement < AGREES else Grade.GOOD


def _findings(vitals: Vitals) -> Iterator[HeadlineProblem]:
    if not vitals.connected:
        yield HeadlineProblem(Grade.BAD, "no connection")
    if vitals.halted and not vitals.conditions.get(RobotHealth.HALTED):
        yield HeadlineProblem(Grade.BAD, "halt not acknowledged")
    if vitals.coordinator_up is False:
        yield HeadlineProblem(Grade.BAD, "coordinator lost")
    if vitals.worst_sigma_m >= UNSURE_M:
        grade = Grade.BAD if vitals.worst_sigma_m >= ASTRAY_M else Grade.WARN
        yield HeadlineProblem(grade, f"{vitals.worst_sigma_robot}: position ± {vitals.worst_sigma_m:.1f} m")
    if vitals.silent_robot:
        text = f"{vitals.silent_robot}: {vitals.silent_error_m:.1f} m off, not reported"
        yield HeadlineProblem(Grade.BAD, text)
    if vitals.share_off > MAP_OFF:
        doubled = f", {vitals.doubled_walls_m:.0f} m of walls doubled" if vitals.doubled_walls_m >= 0.5 else ""
        text = f"{100 * vitals.share_off:.1f} % of the map wrong{doubled}"
        yield HeadlineProblem(map_grade(vitals.share_off), text)
    if vitals.least_agreement < AGREES:
        text = f"{vitals.least_agreement_robot}: lidar agrees {100 * vitals.least_agreement:.0f} % with map"
        yield HeadlineProblem(agreement_grade(vitals.least_agreement), text)
    if vitals.map_refused:
        yield HeadlineProblem(Grade.WARN, "a map patch does not fit")
    if vitals.map_missing:
        yield HeadlineProblem(Grade.WARN, "no map")
    if vitals.late_s > LATE_S:
        grade = Grade.BAD if vitals.late_s > VERY_LATE_S else Grade.WARN
        yield HeadlineProblem(grade, f"data {vitals.late_s:.0f} s late")
