"""Whole runs that leave something to explore: what the coordinator says of it, kind by kind."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from robrain import Scenario
from robrain.client.team import Team
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.maps.map_messages import COORDINATOR_LEFT, ExplorationLeft, LeftKind
from robrain.protocol.model.geometry import Point2D
from robrain.recording.reader.reading import read_messages
from robrain.sim.lockstep.lockstep import LockstepRun, LockstepTransport
from robrain.sim.maps.drawing import Block, FloorDrawing, Wall
from robrain.sim.robot.robot_hardware import RobotHardware
from robrain.sim.traffic.specs import DoorSpec, TrafficSpec
from robrain.sim.world.world import TICK_S
from tests.sim.maps.test_narrow_floor import two_rooms

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
