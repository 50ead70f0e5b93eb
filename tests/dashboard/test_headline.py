"""The headline's dot is the worst of robots, coordinator, localisation, map and lateness."""

import math
from dataclasses import replace

import msgspec
import pytest

from robrain.dashboard.html.team_html import strip_html
from robrain.dashboard.state import headline
from robrain.dashboard.state.headline import Grade, Vitals, headline_of, vitals_of
from robrain.dashboard.state.shown_robot import RobotHealth
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE, RobotState
from robrain.protocol.messages.team.arena_messages import ARENA_TRUTH, ArenaTruth, RobotTruth
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE, TeamState
from robrain.protocol.model.accuracy import MapAccuracy, PoseAccuracy
from robrain.protocol.model.geometry import Pose2D
from tests.dashboard.test_shown_team import patch, tell, tell_place, token

WELL = Vitals({RobotHealth.UP: 3}, coordinator_up=True, worst_sigma_m=0.1, worst_sigma_robot="r1", late_s=0.1)


def with_robots(condition: RobotHealth) -> Vitals:
    return replace(WELL, conditions={RobotHealth.UP: 2, condition: 1})


@pytest.mark.parametrize(
    ("vitals", "grade", "words"),
    [
        (WELL, Grade.GOOD, ()),
        (Vitals(), Grade.GOOD, ()),
        (with_robots(RobotHealth.SILENT), Grade.WARN, ()),
        (with_robots(RobotHealth.LOST), Grade.BAD, ()),
        (with_robots(RobotHealth.HALTED), Grade.BAD, ()),
        (replace(WELL, connected=False), Grade.BAD, ("no connection",)),
        (replace(WELL, halted=True), Grade.BAD, ("halt not acknowledged",)),
        (replace(with_robots(RobotHealth.HALTED), halted=True), Grade.BAD, ()),
        (replace(WELL, coordinator_up=False), Grade.BAD, ("coordinator lost",)),
        (replace(WELL, worst_sigma_m=headline.UNSURE_M), Grade.WARN, ("r1: position ± 0.5 m",)),
        (replace(WELL, worst_sigma_m=headline.ASTRAY_M), Grade.BAD, ("r1: position ± 2.0 m",)),
        (replace(WELL, worst_sigma_m=math.nan), Grade.GOOD, ()),
        (replace(WELL, share_off=0.031), Grade.WARN, ("3.1 % of the map wrong",)),
        (
            replace(WELL, share_off=headline.MAP_FAR_OFF + 0.01, doubled_walls_m=12.6),
            Grade.BAD,
            ("6.0 % of the map wrong, 13 m of walls doubled",),
        ),
        (
            replace(WELL, silent_robot="r2", silent_error_m=1.24),
            Grade.BAD,
            ("r2: 1.2 m off, not reported",),
        ),
        (
            replace(WELL, least_agreement=0.55, least_agreement_robot="r3"),
            Grade.WARN,
            ("r3: lidar agrees 55 % with map",),
        ),
        (
            replace(WELL, least_agreement=headline.HARDLY_AGREES - 0.1, least_agreement_robot="r3"),
            Grade.BAD,
            ("r3: lidar agrees 40 % with map",),
        ),
        (replace(WELL, map_missing=True), Grade.WARN, ("no map",)),
        (replace(WELL, map_refused=True), Grade.WARN, ("a map patch does not fit",)),
        (replace(WELL, late_s=1.6), Grade.WARN, ("data 2 s late",)),
        (replace(WELL, late_s=1.6, coordinator_up=False), Grade.BAD, ("coordinator lost", "data 2 s late")),
    ],
)
def test_worst_of_all_counts(vitals: Vitals, grade: Grade, words: tuple[str, ...]) -> None:
    headline = headline_of(vitals)
    assert headline.grade is grade
    assert tuple(finding.words for finding in headline.findings) == words


def test_what_is_heard_of_a_team_becomes_its_vitals() -> None:
    view = ShownTeam()
    assert headline_of(vitals_of(view, 0.0)).grade is Grade.GOOD
    view.apply_presence(token("r1", True))
    view.coordinator_up = True
    tell_place(view, "r1", 0.0, 1.0)
    tell(view, ROBOT_MAP, patch([[0, 100]]), 1.0, robot="r1")
    tell(view, COORDINATOR_STATE, TeamState(robots=[]), 1.0)
    assert headline_of(vitals_of(view, 1.2)).grade is Grade.GOOD
    assert vitals_of(view, 3.0).late_s == 2.0
    view.coordinator_up = False
    assert [finding.words for finding in headline_of(vitals_of(view, 1.2)).findings] == ["coordinator lost"]
    assert 'class="rb-bad">▲</i>' in strip_html(view, 1.2)
    view.is_replay = True
    assert vitals_of(view, 1.2).coordinator_up is None


def test_map_counts_as_missing_after_a_while_and_a_patch_that_does_not_fit_for_a_while() -> None:
    view = ShownTeam()
    for at_s in (0.0, headline.MAPLESS_S + 1):
        assert not vitals_of(view, at_s).map_missing
        tell_place(view, "r1", 0.0, at_s)
    assert vitals_of(view, headline.MAPLESS_S + 1).map_missing
    tell(view, ROBOT_MAP, patch([[0, 100]]), headline.MAPLESS_S + 1, robot="r1")
    assert not vitals_of(view, headline.MAPLESS_S + 1).map_missing
    tell(view, ROBOT_MAP, msgspec.structs.replace(patch([[0]]), width=99), 20.0, robot="r1")
    assert vitals_of(view, 20.0).map_refused
    assert not vitals_of(view, 20.1 + headline.REFUSED_S).map_refused


def truth_of(*robots: tuple[str, PoseAccuracy | None], off: int = 0, cells: int = 1000) -> ArenaTruth:
    here = Pose2D(0.0, 0.0, 0.0)
    told = [
        RobotTruth(robot=name, pose=here, collisions=0, distance_m=0.0, energy_j=0.0, accuracy=accuracy)
        for name, accuracy in robots
    ]
    of_map = MapAccuracy(occupied_cells=cells, cells_off=off, share_off=off / cells, doubled_walls_m=off / 10)
    return ArenaTruth(sim_time_s=1.0, robots=told, map_accuracy=of_map)


def agreeing(robot: str, agreement: float | None) -> RobotState:
    return RobotState(robot=robot, pose=Pose2D(0.0, 0.0, 0.0), map_agreement=agreement)


def text_of(view: ShownTeam, now_s: float = 0.0) -> list[str]:
    return [finding.words for finding in headline_of(vitals_of(view, now_s)).findings]


def seen(*agreements: tuple[str, float | None]) -> ShownTeam:
    view = ShownTeam()
    view.coordinator_up = True
    for robot, agreement in agreements:
        tell(view, ROBOT_STATE, agreeing(robot, agreement), robot=robot)
    return view


def test_map_and_silent_robots_are_judged_by_the_truth_where_it_is_told() -> None:
    view = seen(("r1", 0.95), ("r2", 0.95), ("r3", 0.1))
    well, off = PoseAccuracy(error_m=0.1), PoseAccuracy(error_m=0.8, silent_for_s=0.2)
    tell(view, ARENA_TRUTH, truth_of(("r1", well), ("r2", well), ("r3", None), off=20))
    assert text_of(view) == []  # what robots say of their own scans does not count then
    far = PoseAccuracy(error_m=2.5, silent_for_s=3.0)
    tell(view, ARENA_TRUTH, truth_of(("r1", off), ("r2", far), ("r3", None), off=60))
    assert text_of(view) == ["r2: 2.5 m off, not reported", "6.0 % of the map wrong, 6 m of walls doubled"]
    assert 'class="rb-bad">▲</i>' in strip_html(view, 0.0)
    assert text_of(view, 60.0) == ["6.0 % of the map wrong, 6 m of walls doubled"]  # nobody in contact


def test_without_a_truth_the_robot_whose_lidar_agrees_least_counts() -> None:
    view = seen(("r1", 0.9), ("r2", 0.6), ("r3", None))
    assert text_of(view) == ["r2: lidar agrees 60 % with map"]
    assert text_of(seen(("r1", None))) == []
    assert text_of(view, 60.0) == []  # it is not in contact any more
