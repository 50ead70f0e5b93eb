"""What viewers see of a lockstep run before its first step."""

import numpy as np
import pytest
import zenoh

from robrain import Scenario
from robrain.algorithms.mapping.patch_cells import cells_of, geometry_of
from robrain.protocol.clock import LiveClock, VirtualClock
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.team.arena_messages import ARENA_PREPARATION
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import listening_at, open_lockstep_session, open_session
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.lockstep.start_picture import StartPicture, floor_classes
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.world.referee import EDGE_CELLS
from robrain.sim.world.world import World
from tests.waiting import until

SMALL = Scenario.builtin("arena_small").replace(robots=2)


def test_floor_has_the_surfaces_of_walls_and_says_nothing_of_what_is_inside() -> None:
    occupied = np.zeros((10, 10), np.bool_)
    occupied[:, 4:] = True
    classes = floor_classes(FloorPlan(occupied, 0.1, 0.0, 0.0, "half"))
    inner = classes[EDGE_CELLS:-EDGE_CELLS, EDGE_CELLS:-EDGE_CELLS]
    assert inner.shape == (10, 10)
    assert (inner[:, :4] == FREE).all()
    assert (inner[:, 4] == OCCUPIED).all()
    assert (inner[:, 5:] == UNKNOWN).all()
    assert (classes[:EDGE_CELLS] == UNKNOWN).all()


@pytest.mark.slow
def test_others_see_robots_and_floor_before_the_run_is_set_up_and_the_digest_stays() -> None:
    digests = []
    for is_shown in (False, True):
        session, world = open_lockstep_session("tcp/127.0.0.1:0"), SMALL.world()
        if is_shown:
            _watch(session, world)
        run = LockstepRun(world, session=session)
        try:
            for _ in range(25):
                run.tick()
            assert run.outside == 0
            digests.append(run.digest)
        finally:
            run.close()
    assert digests[0] == digests[1]


def _watch(session: zenoh.Session, world: World) -> None:
    watching = open_session(connect=listening_at(session))
    viewer, inbox = Endpoint(watching, DEFAULT_TEAM, LiveClock(), Drive.LIVE), Inbox()
    try:
        viewer.subscribe(inbox, ARENA_PREPARATION)
        picture = StartPicture(Endpoint(session, DEFAULT_TEAM, VirtualClock(), Drive.LOCKSTEP), world)

        def is_there() -> bool:
            picture.show(2, 16, 7.5)
            return inbox.has_some

        until(is_there, "no picture has come")
        picture.close()
        seen = inbox.drain()[-1].message
    finally:
        viewer.close()
        watching.close()
    assert (seen.parts_ready, seen.parts, seen.remaining_s) == (2, 16, 7.5)
    assert [robot.robot for robot in seen.truth.robots] == ["r1", "r2"]
    assert seen.truth.robots[0].pose == world.robots[0].start
    assert np.array_equal(cells_of(seen.floor), floor_classes(world.plan))
    assert geometry_of(seen.floor).shape == floor_classes(world.plan).shape
