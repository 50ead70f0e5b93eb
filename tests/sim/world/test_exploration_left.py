"""Whole runs that leave something to explore: what the coordinator says of it, kind by kind."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from robrain import Scenario
from robrain.client.team import Team
from robrain.coordinator.parts.exploration import Exploration
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.maps.map_messages import (
    COORDINATOR_LEFT,
    COORDINATOR_LEFT_NOW,
    ExplorationLeft,
    LeftKind,
)
from robrain.protocol.model.geometry import Point2D
from robrain.recording.reader.reading import read_messages
from robrain.sim.lockstep.lockstep import LockstepRun, LockstepTransport
from robrain.sim.maps.drawing import Block, FloorDrawing, Pillar, Wall
from robrain.sim.robot.robot_hardware import RobotHardware
from robrain.sim.traffic.specs import DoorSpec, TrafficSpec
from robrain.sim.world.world import TICK_S
from tests.sim.maps.test_narrow_floor import rooms_joined_by_a_bend, two_rooms

LIMIT_S = 150.0


def scenario(floor: FloorDrawing, *, robots: int = 2, seed: int = 1, doors: tuple[DoorSpec, ...] = ()) -> Scenario:
    return Scenario(
        name="left",
        floor=floor,
        robots=robots,
        near=Point2D(2.0, 2.0),
        seed=seed,
        hardware=RobotHardware(radius_m=0.2),
        traffic=TrafficSpec(doors=doors),
        time_limit_s=LIMIT_S,
    )


@contextmanager
def running(of: Scenario) -> Iterator[LockstepRun]:
    run = LockstepRun(of.world())
    try:
        yield run
    finally:
        run.close()


def explored(run: LockstepRun) -> ExplorationLeft:
    """What is left when no robot has anything to explore."""
    while not run.nothing_left:
        assert run.sim_time_s < LIMIT_S
        run.tick()
    assert run.arena.collisions == 0
    left = run.publish_exploration_left()
    assert left is not None
    return left


def fence(pitch_m: float) -> FloorDrawing:
    """A room of 8 × 4.4 m with posts of 0.1 m across its middle."""
    posts = tuple(Pillar(4.0, 0.1 + number * pitch_m, 0.05) for number in range(int(4.3 / pitch_m)))
    return FloorDrawing(size_m=(8.0, 4.4), resolution_m=0.05, pillars=posts)


@pytest.mark.slow
def test_floor_behind_a_fence_that_can_be_seen_through_is_too_narrow_and_is_not_tried() -> None:
    with running(scenario(fence(0.3))) as run:
        (region,) = explored(run).regions
        assert run.sim_time_s < 30.0
    assert (region.kind, region.gap_at) == (LeftKind.TOO_NARROW, None)
    assert region.gap_m == pytest.approx(0.2, abs=0.11)
    assert region.area_m2 > 8.0


@pytest.mark.slow
def test_floor_seen_through_a_fence_whose_gaps_the_map_does_not_show_is_unreachable() -> None:
    with running(scenario(fence(0.15))) as run:
        regions = explored(run).regions
    assert LeftKind.UNREACHABLE in {region.kind for region in regions}
    assert all(region.place.x_m > 4.0 for region in regions)


ROOMS_AND_DOORWAY = FloorDrawing(
    size_m=(8.0, 4.4), resolution_m=0.05, walls=(Wall((4.0, 0.0), (4.0, 1.6)), Wall((4.0, 2.8), (4.0, 4.4)))
)


@pytest.mark.slow
def test_a_room_whose_door_has_closed_behind_the_robot_is_cut_off() -> None:
    """The robot explores the room on the right with shelves in it, is called back, and the door closes behind it."""
    shelves = (Block(5.2, 0.8, 0.6, 2.6), Block(6.6, 1.4, 0.3, 2.6))
    floor = FloorDrawing(
        size_m=ROOMS_AND_DOORWAY.size_m, resolution_m=0.05, walls=ROOMS_AND_DOORWAY.walls, blocks=shelves
    )
    door = DoorSpec(from_m=(4.0, 1.6), to_m=(4.0, 2.8), thickness_m=0.15, open_s=((0.0, 60.0),))
    with running(scenario(floor, robots=1, doors=(door,))) as run:
        explored(run)
        assert run.explored_fraction > 0.97
        was_there = run.arena.bodies[0].x_m > 4.0
        assert was_there
        _send(run, Point2D(1.0, 3.5))
        while run.sim_time_s < 70.0:
            run.tick()
        assert run.arena.bodies[0].x_m < 4.0
        _send(run, Point2D(2.5, 1.2))
        while run.sim_time_s < 90.0:
            run.tick()
        left = run.publish_exploration_left()
    assert left is not None
    (region,) = left.regions
    assert region.kind is LeftKind.CUT_OFF
    assert region.place.x_m > 4.0


def _send(run: LockstepRun, place: Point2D) -> None:
    Team(LockstepTransport(run), by="test").submit("visit", place=place)


@pytest.mark.slow
def test_a_frontier_where_robots_fail_again_and_again_is_tried() -> None:
    """The coordinator is told of two failures there, as by robots whose tasks have failed."""
    with running(scenario(two_rooms(1.0))) as run:
        explorer, left = run.coordinator.part(Exploration).explorer, None
        while run.sim_time_s < 1.0:
            run.tick()
        left = run.publish_exploration_left()
        assert left is not None
        (region,) = [region for region in left.regions if region.area_m2 > 3.0]
        assert region.kind is LeftKind.UNSEEN
        for robot in ("r1", "r2"):
            explorer.record_failure(robot, region.place, run.clock.now_ns())
        left = run.publish_exploration_left()
    assert left is not None
    (tried,) = [region for region in left.regions if region.area_m2 > 3.0]
    assert (tried.kind, tried.tries) == (LeftKind.TRIED, 2)


@pytest.mark.slow
def test_at_the_time_limit_open_frontiers_are_unseen_and_the_last_word_is_in_the_recording(tmp_path: Path) -> None:
    result = scenario(two_rooms(1.0)).run(time_limit_s=0.4, record=tmp_path / "run.mcap")
    assert result.ended == "time_limit"
    left = result.exploration_left
    assert left is not None
    assert {region.kind for region in left.regions} == {LeftKind.UNSEEN}
    told = [one for one in read_messages(tmp_path / "run.mcap") if one.topic_key == COORDINATOR_LEFT.key("default")]
    (recorded,) = [COORDINATOR_LEFT.payloads.read(one.payload) for one in told]
    assert recorded.regions == left.regions


@pytest.mark.slow
def test_a_room_behind_a_gap_in_which_robots_failed_is_told_once_with_the_width_and_by_idle_robots() -> None:
    with running(scenario(two_rooms(0.4))) as run:
        inbox = Inbox()
        run._watcher.subscribe(inbox, COORDINATOR_LEFT)
        while not inbox.has_some:
            run.tick()
            assert run.sim_time_s < LIMIT_S
        assert not run.nothing_left
        for _ in range(10):
            run.tick()
        assert run.nothing_left
        assert run.arena.collisions == 0
        assert set(run.idle) == {"r1", "r2"}
        for reason in run.idle.values():
            assert reason.code == "too_narrow"
            assert reason.values["gap_m"] == pytest.approx(0.4, abs=0.04)
            assert reason.values["x_m"] < 4.2
        for _ in range(round(6.0 / TICK_S)):
            run.tick()
        (told,) = inbox.drain()
        (region,) = told.message.regions
        assert (region.kind, region.needed_m) == (LeftKind.TOO_NARROW, 0.44)
        assert region.gap_m == pytest.approx(0.4, abs=0.04)
        assert region.gap_at.x_m == pytest.approx(3.8, abs=0.3)
        assert region.place.x_m > 4.0
        assert region.high.x_m > 9.0
        run.publish_exploration_left()
        inbox.drain()
        run.publish_exploration_left()
        assert not inbox.has_some


@pytest.mark.slow
def test_while_robots_explore_it_is_told_on_request() -> None:
    with running(scenario(two_rooms(1.0))) as run:
        assert run._watcher.ask(COORDINATOR_LEFT_NOW) is None
        for _ in range(round(1.0 / TICK_S)):
            run.tick()
        left = run._watcher.ask(COORDINATOR_LEFT_NOW)
    assert left is not None
    assert LeftKind.UNSEEN in {region.kind for region in left.regions}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3])
def test_the_floor_behind_the_bends_of_a_barely_passable_corridor_is_explored(seed: int) -> None:
    """The frontier behind the bend is 3 cells long; seeds with which it was once left and not named."""
    with running(scenario(rooms_joined_by_a_bend(0.45), seed=seed)) as run:
        assert explored(run).regions == []
        assert run.explored_fraction > 0.99
