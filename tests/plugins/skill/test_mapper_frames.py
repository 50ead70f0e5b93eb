"""In which map frame a robot maps: it begins one, leaves one, finds a better one, and follows mates."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.mapping.local_map import ArenaFix
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


MIDDLE = PLACES[1]


def test_old_answers_are_forgotten_when_many_newer_ones_say_otherwise() -> None:
    scene = lost()
    for _ in range(2):
        assert not scene.search(MIDDLE)
    for n in range(1, ANSWERS_MAX + 1):
        scene.mates_map(ARENA, Pose2D(0.4 * n, 0.0, 0.0))
        assert not scene.search(MIDDLE)
    scene.mates_map(ARENA, IDENTITY)
    assert not scene.search(MIDDLE)
