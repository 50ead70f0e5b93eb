"""In which map frame a robot maps: it begins one, leaves one, finds a better one, and follows mates."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.mapping.local_map import NO_DRIFT, ArenaFix
from robrain.algorithms.slam.map_patch import joined_message, pose_message
from robrain.plugins.skill.mapper import frames as module
from robrain.plugins.skill.mapper.frames import ANSWERS_MAX, ANSWERS_MIN, FrameMove
from robrain.protocol.messages.maps.map_messages import MapPatch
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED
from robrain.protocol.model.map_frame import ARENA, MapFrame
from tests.plugins.unit.frame_scene import MATES, OWN, PLACES, SURE, T_OWN_FLOOR, WHY, WIDE, Scene, lost, off


def told(scene: Scene) -> dict[int, tuple[Pose2D, MapFrame]]:
    return {each.submap: (each.T_arena_local, each.frame) for each in scene.frames.outgoing}


def test_a_robot_that_knows_its_place_maps_in_the_arena_frame() -> None:
    scene = Scene()
    scene.frames.begin(20, "")
    assert (scene.frames.frame, scene.own.reason, scene.atlas.frame) == (ARENA, "", ARENA)


def test_one_that_does_not_begins_a_frame_of_its_own() -> None:
    scene = Scene()
    scene.frames.begin(20, WHY)
    assert (scene.frames.frame, scene.own.reason, scene.atlas.frame) == (OWN, WHY, OWN)
    assert scene.frames.outgoing == []


@pytest.mark.parametrize(
    ("frame", "name"), [(ARENA, "the arena frame"), (MATES, "a frame of r2, begun with submap 10")]
)
def test_three_answers_that_agree_move_the_robot_into_the_better_frame(
    frame: MapFrame, name: str, caplog: pytest.LogCaptureFixture
) -> None:
    scene = lost(mates=frame)
    caplog.clear()
    moved = [scene.search(place) for place in PLACES[: ANSWERS_MIN + 1]]
    assert moved == [False, False, True, False]
    assert scene.frames.frame == scene.atlas.frame == scene.graph.own[20].frame == frame
    for place in PLACES:
        assert off(scene.own.T_arena_local.compose(T_OWN_FLOOR.compose(place)), place) == pytest.approx(
            (0.0, 0.0, 0.0), abs=0.08
        )
    assert scene.own.reason == ("" if frame == ARENA else WHY), "in the mate's frame it is still lost"
    assert told(scene) == {20: (scene.own.T_arena_local, frame)}
    assert scene.atlas.place_of(("r1", 20), frame) == scene.own.T_arena_local
    assert scene.graph.own[20].T_arena_local == scene.own.T_arena_local
    assert scene.graph.has_news
    assert [record.message for record in caplog.records] == [f"r1: maps in {name}"]


@pytest.mark.parametrize(("apart_m", "is_sure"), [(0.5, False), (0.95, False), (1.1, True)])
def test_answers_must_come_from_places_apart(monkeypatch: pytest.MonkeyPatch, apart_m: float, is_sure: bool) -> None:
    monkeypatch.setattr(module, "PLAIN_MIN", 1_000_000)
    scene = lost()
    moved = [scene.search(Pose2D(2.0 + 0.5 * n * apart_m, 3.1, 0.0)) for n in range(3)]
    assert moved == [False, False, is_sure]


def test_a_robot_that_stands_moves_into_a_better_frame_only_if_very_many_walls_agree(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = lost()
    assert [scene.search(PLACES[1]) for _ in range(3)] == [False, False, True]
    monkeypatch.setattr(module, "PLAIN_MIN", 1_000_000)
    scene = lost()
    assert not any(scene.search(PLACES[1]) for _ in range(9))


def test_what_other_sensors_speak_against_is_no_answer() -> None:
    scene, asked = lost(), []

    def may_be_at(frame: MapFrame, pose: Pose2D) -> bool:
        asked.append((frame, pose))
        return False

    assert not any(scene.search(place, may_be_at) for place in PLACES * 2)
    assert {frame for frame, _ in asked} == {ARENA}
    for (_, pose), place in zip(asked, PLACES * 2, strict=True):
        assert off(pose, place) == pytest.approx((0.0, 0.0, 0.0), abs=0.08)


def test_a_robot_never_moves_into_a_frame_that_was_begun_later() -> None:
    scene = lost(mates=MapFrame(21, "r0"))
    assert not any(scene.search(place) for place in PLACES * 2)
    scene = Scene()
    scene.map(5, PLACES[0], trajectory=0)
    scene.mates_map(MATES)
    assert not any(scene.search(place) for place in PLACES * 2), "the arena frame is the first"


def test_every_better_frame_is_searched_in_turn() -> None:
    scene = lost()
    far = np.full((40, 4), FREE, np.int8)
    far[:, 0] = OCCUPIED
    scene.atlas.move(("r3", 1), IDENTITY, MATES)
    scene.atlas.merge(("r3", 1), 100, 100, far, 5)
    moved = [scene.search(PLACES[n % 4]) for n in range(6)]
    assert moved.index(True) in {4, 5}
    assert scene.frames.frame == ARENA


def test_a_robot_that_is_where_nobody_has_been_is_looked_for_where_it_was_before() -> None:
    scene = Scene()
    scene.map(20, PLACES[1])
    scene.map(21, PLACES[2])
    nowhere = T_OWN_FLOOR.inverse().compose(Pose2D(11.0, 11.0, 0.0))
    scene.own.begin_submap(22, T_OWN_FLOOR.compose(nowhere), NO_DRIFT, SURE)
    scene.mates_map(ARENA)
    moved = [scene.search(nowhere) for _ in range(4 * ANSWERS_MIN + 1)]
    assert moved.index(True) == 4 * ANSWERS_MIN - 2, "every fourth search"
    assert off(scene.own.T_arena_local.compose(T_OWN_FLOOR), IDENTITY) == pytest.approx((0.0, 0.0, 0.0), abs=0.08)


def test_a_mate_that_is_where_the_robot_has_been_is_looked_for_on_the_robots_map() -> None:
    """The robot itself stands where nothing is to be seen."""
    scene = lost()
    nowhere = T_OWN_FLOOR.inverse().compose(Pose2D(11.0, 11.0, 0.0))
    assert not any(scene.search(nowhere) for _ in range(9))
    scene.mates = {ARENA: [(PLACES[1].x_m, PLACES[1].y_m, 0.2)]}
    moved = [scene.search(nowhere) for _ in range(2 * ANSWERS_MIN + 1)]
    assert moved.index(True) in {2 * ANSWERS_MIN - 2, 2 * ANSWERS_MIN - 1}, "every second search"
    assert off(scene.own.T_arena_local.compose(T_OWN_FLOOR), IDENTITY) == pytest.approx((0.0, 0.0, 0.0), abs=0.08)


def crate_at(scene: Scene, at: Pose2D, frame: MapFrame) -> None:
    """What a mate has drawn: a crate of 0.4 m."""
    row, column = WIDE.cell_of(at.x_m, at.y_m)
    scene.atlas.move(("r2", 8), IDENTITY, frame)
    scene.atlas.merge(("r2", 8), row - 2, column - 2, np.full((4, 4), OCCUPIED, np.int8), 50)


def test_where_robots_are_or_have_been_crates_on_a_map_contradict_nothing() -> None:
    crate = Pose2D(2.1, 4.9, 0.0)
    scene = lost()
    crate_at(scene, crate, ARENA)
    assert not any(scene.search(place) for place in PLACES[:3])
    scene.mates = {ARENA: [(crate.x_m, crate.y_m, 0.3)]}
    assert any(scene.search(PLACES[n % 3]) for n in range(8)), "it may be the mate"
    for began in (True, False):
        scene = lost()
        crate_at(scene, PLACES[0] if began else PLACES[1], ARENA)
        moved = [scene.search(place) for place in (PLACES[1], PLACES[1], PLACES[1])]
        assert moved == [False, False, True], "it may be this robot, where it began its submap or where it is"


@pytest.mark.parametrize(("was_there", "joins"), [(False, False), (True, True)])
def test_a_robot_that_was_in_a_frame_before_needs_less_evidence(
    monkeypatch: pytest.MonkeyPatch, was_there: bool, joins: bool
) -> None:
    monkeypatch.setattr(module, "EVIDENCE_MIN", 1_000_000)
    scene = Scene()
    if was_there:
        scene.map(5, PLACES[0], T_own_floor=IDENTITY, trajectory=0)
    scene.map(20, *PLACES)
    scene.mates_map(ARENA)
    moved = [scene.search(place) for place in PLACES[:3]]
    assert any(moved) == joins


@pytest.mark.parametrize(("frame", "joins"), [(ARENA, False), (MATES, True)])
def test_a_robot_that_would_be_beyond_the_edge_of_the_arena_is_somewhere_else(frame: MapFrame, joins: bool) -> None:
    """The map of a frame of a robot's own has its edge anywhere."""
    scene = Scene()
    scene.map(20, *PLACES)
    scene.mates_map(frame, Pose2D(-13.0, 0.0, 0.0))
    moved = [scene.search(place) for place in PLACES[:3]]
    assert any(moved) == joins


@pytest.mark.parametrize(("strangers", "joins"), [(0, False), (1, True)])
def test_a_crate_may_be_a_mate_of_which_nobody_knows_where_it_is(strangers: int, joins: bool) -> None:
    scene = lost()
    scene.strangers = strangers
    crate_at(scene, Pose2D(2.1, 4.9, 0.0), ARENA)
    moved = [scene.search(place) for place in PLACES[:3]]
    assert any(moved) == joins


def test_joining_moves_the_submaps_of_that_frame_only_and_tells_them_alone() -> None:
    scene = Scene()
    scene.map(5, PLACES[0], T_own_floor=IDENTITY, trajectory=0)
    scene.map(20, PLACES[0])
    scene.map(21, PLACES[1])
    scene.mates_map(OWN, Pose2D(1.0, 0.0, 0.0))
    fix = ArenaFix(Pose2D(3.0, 1.0, 0.5), Pose2D(3.0, 2.0, 0.0), SURE, 1)
    scene.frames.apply_fix(fix)
    assert scene.frames.frame == ARENA
    assert set(told(scene)) == {20, 21}
    for number in (20, 21):
        place, frame = told(scene)[number]
        assert frame == ARENA
        assert off(place, fix.T_arena_frame) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
        assert scene.atlas.place_of(("r1", number)) == place
    assert scene.atlas.place_of(("r1", 5)) == IDENTITY
    assert scene.atlas.place_of(("r2", 7), OWN) == Pose2D(1.0, 0.0, 0.0), "a mate follows by itself"
    assert np.array_equal(scene.atlas.grid.classes(), scene.atlas.composed(ARENA).classes())


@pytest.mark.parametrize(("trajectory", "is_taken"), [(1, True), (0, False), (2, False)])
def test_what_motes_said_before_the_map_was_begun_anew_is_out_of_date(trajectory: int, is_taken: bool) -> None:
    scene = lost(mates=None)
    scene.frames.apply_fix(ArenaFix(Pose2D(3.0, 1.0, 0.5), IDENTITY, SURE, trajectory))
    assert (scene.frames.frame == ARENA) == is_taken


def test_a_robot_that_lies_wrong_leaves_with_the_submaps_of_this_trajectory_as_they_lie() -> None:
    scene = Scene()
    scene.map(5, PLACES[0], trajectory=0)
    scene.own.begin_trajectory(3)
    scene.frames.begin(20, "")
    for number in (20, 21):
        scene.map(number, PLACES[1], trajectory=3)
    scene.frames.part("mates contradict it")
    assert (scene.frames.frame, scene.own.reason) == (OWN, "mates contradict it")
    assert told(scene) == {20: (IDENTITY, OWN), 21: (IDENTITY, OWN)}
    assert scene.atlas.place_of(("r1", 5)) == IDENTITY
    assert scene.atlas.place_of(("r1", 21), OWN) == IDENTITY
    assert [node.frame for node in scene.graph.own.values()] == [ARENA, OWN, OWN]


@pytest.mark.parametrize(
    ("variance_m2", "mates", "is_unsure"),
    [(0.98, ARENA, False), (1.02, ARENA, True), (1.02, MATES, False), (1.02, None, False)],
)
def test_a_robot_that_hardly_knows_its_place_leaves_unless_it_is_alone_in_the_arena_frame(
    variance_m2: float, mates: MapFrame | None, is_unsure: bool
) -> None:
    scene = Scene()
    assert scene.frames.uncertainty_reason() == ""
    scene.map(20, *PLACES, trajectory=0)
    if mates is not None:
        scene.mates_map(mates)
    for axis in (0, 1):
        scene.graph.own[20].covariance = np.diag((0.1, 0.1, 0.01))
        scene.graph.own[20].covariance[axis, axis] = variance_m2
        assert (scene.frames.uncertainty_reason() == "its place is known to ± 1.0 m only") == is_unsure
    if is_unsure:
        scene.frames.part(scene.frames.uncertainty_reason())
        assert scene.frames.uncertainty_reason() == "", "it has left"


@pytest.mark.parametrize(("variances", "joins"), [((1.1, 1.1, 0.001), False), ((400.0, 400.0, 4.0), True)])
def test_a_robot_that_was_only_unsure_joins_only_where_its_last_place_allows(
    variances: tuple[float, float, float], joins: bool
) -> None:
    scene = Scene()
    scene.map(20, *PLACES, trajectory=0)
    scene.mates_map(ARENA)
    scene.graph.own[20].covariance = np.diag(variances)
    scene.frames.part(scene.frames.uncertainty_reason())
    assert any(scene.search(place) for place in PLACES) is joins


def moved(number: int, place: Pose2D, frame: MapFrame, *, robot: str = "r2", withdrawn: bool = False) -> MapPatch:
    return pose_message(robot, WIDE, number, place, frame, withdrawn=withdrawn)


THERE = Pose2D(3.0, -1.0, 0.7)


@settings(deadline=None, max_examples=30)
@given(st.builds(Pose2D, st.floats(-9.0, 9.0), st.floats(-9.0, 9.0), st.floats(-3.1, 3.1)), st.booleans())
def test_a_mate_that_mapped_in_the_robots_frame_says_how_that_lies_in_a_better_one(place: Pose2D, joined: bool) -> None:
    scene = Scene()
    scene.map(20, PLACES[0])
    scene.atlas.move(("r2", 7), place, OWN)
    scene.atlas.merge(("r2", 7), 0, 0, np.full((2, 2), FREE, np.int8), 5)
    patch = moved(7, THERE.compose(place), ARENA)
    move = scene.frames.move_of(joined_message("r2", WIDE, [patch]) if joined else patch)
    assert move is not None
    assert move.frame == ARENA
    assert off(move.T_new_old, THERE) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)


@pytest.mark.parametrize(
    "patch",
    [
        moved(7, THERE, OWN),  # within the frame
        moved(7, THERE, MapFrame(21, "r2")),  # into a frame that was begun later
        moved(7, THERE, ARENA, withdrawn=True),
        moved(8, THERE, ARENA),  # a submap of which nothing is known
        moved(9, THERE, ARENA),  # one in another frame
        joined_message("r3", WIDE, [moved(7, THERE, ARENA)]),  # hearsay
        joined_message("r2", WIDE, [moved(7, THERE, OWN)]),
    ],
)
def test_what_says_nothing_of_a_better_frame_is_no_move(patch: MapPatch) -> None:
    scene = lost(mates=OWN)
    scene.mates_map(MATES, number=9)
    scene.mates_map(OWN, number=0)  # the number in a message that has parts only
    assert scene.frames.move_of(patch) is None


def test_one_submap_of_several_that_a_mate_has_moved_is_enough() -> None:
    scene = lost(mates=OWN)
    move = scene.frames.move_of(joined_message("r2", WIDE, [moved(8, THERE, ARENA), moved(7, THERE, ARENA)]))
    assert move is not None
    assert off(move.T_new_old, THERE) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)


def test_a_robot_follows_a_mate_with_all_that_it_has_mapped_in_the_frame() -> None:
    scene = lost(mates=OWN)
    scene.map(21, PLACES[3])
    before = scene.graph.own[21].pose
    scene.frames.follow(FrameMove(MATES, THERE))
    assert (scene.frames.frame, scene.own.reason) == (MATES, WHY)
    assert set(told(scene)) == {20, 21}
    assert off(scene.own.T_arena_local, THERE) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    assert off(scene.graph.own[21].pose, THERE.compose(before)) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    scene.frames.follow(FrameMove(ARENA, THERE.inverse()))
    assert (scene.frames.frame, scene.own.reason) == (ARENA, "")
    assert off(scene.own.T_arena_local, IDENTITY) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)


def test_a_follower_is_less_sure_of_its_submaps_than_before() -> None:
    scene = lost(mates=OWN)
    before = np.diag(scene.graph.own[20].covariance).copy()
    scene.frames.follow(FrameMove(ARENA, Pose2D(3.0, -1.0, 0.0)))
    assert np.all(np.diag(scene.graph.own[20].covariance) - before == pytest.approx((0.05**2, 0.05**2, 0.01**2)))


MIDDLE = PLACES[1]


def turned_about(place: Pose2D, turn_rad: float) -> Pose2D:
    """A frame that is turned about a place, which stays where it is."""
    return place.compose(Pose2D(0.0, 0.0, turn_rad)).compose(place.inverse())


@pytest.mark.parametrize(
    ("turn_rad", "aside_m", "is_sure"),
    [
        (0.0, 0.0, True),
        (0.02, 0.0, True),
        (0.035, 0.0, False),
        (0.0, 0.07, True),
        (0.0, 0.11, True),
        (0.0, 0.18, False),
    ],
)
def test_answers_that_turn_the_robot_or_put_it_more_than_three_decimetres_aside_do_not_agree(
    turn_rad: float, aside_m: float, is_sure: bool
) -> None:
    scene, moved = lost(), []
    for n in (-1, 0, 1):
        scene.mates_map(ARENA, Pose2D(0.0, n * aside_m, 0.0).compose(turned_about(MIDDLE, n * turn_rad)))
        moved.append(scene.search(MIDDLE))
    assert moved == [False, False, is_sure]


def test_answers_of_one_frame_say_nothing_of_another() -> None:
    scene = lost()
    scene.mates_map(MATES, number=9)
    assert [scene.search(MIDDLE) for _ in range(5)] == [False] * 4 + [True], "both are searched in turn"


def test_old_answers_are_forgotten_when_many_newer_ones_say_otherwise() -> None:
    scene = lost()
    for _ in range(2):
        assert not scene.search(MIDDLE)
    for n in range(1, ANSWERS_MAX + 1):
        scene.mates_map(ARENA, Pose2D(0.4 * n, 0.0, 0.0))
        assert not scene.search(MIDDLE)
    scene.mates_map(ARENA, IDENTITY)
    assert not scene.search(MIDDLE)


def test_places_of_mates_count_as_places_from_which_answers_were_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The robot itself stands all the time, where nothing is to be seen."""
    monkeypatch.setattr(module, "PLAIN_MIN", 1_000_000)
    nowhere = T_OWN_FLOOR.inverse().compose(Pose2D(11.0, 11.0, 0.0))
    for places, is_sure in (((PLACES[1], PLACES[1]), False), ((PLACES[1], PLACES[3]), True)):
        scene = lost()
        moved = []
        for n in range(12):
            at = places[n // 3 % 2]
            scene.mates = {ARENA: [(at.x_m, at.y_m, 0.2)]}
            moved.append(scene.search(nowhere))
        assert any(moved) == is_sure


def test_a_robot_that_joins_is_surest_of_its_submaps_where_it_was_found() -> None:
    scene = lost()
    scene.map(21, Pose2D(7.0, 5.0, 0.0))
    before = {number: np.diag(node.covariance).copy() for number, node in scene.graph.own.items()}
    moved = [scene.search(place) for place in (PLACES[0], PLACES[0], PLACES[0])]
    assert moved == [False, False, True]
    grown = {number: np.diag(node.covariance) - before[number] for number, node in scene.graph.own.items()}
    near, far = grown[20], grown[21]
    assert math.sqrt(near[:2].sum()) == pytest.approx(0.1 * math.sqrt(2.0), abs=0.02)
    assert far[0] > 1.2 * near[0]
    assert (near[2], far[2]) == pytest.approx((0.02**2, 0.02**2))
