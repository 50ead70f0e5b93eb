"""A coordinator's process from its start to its end: live first, then all that it needs; nobody stays behind."""

import signal
from contextlib import suppress

import numpy as np
import psutil
import pytest

from robrain.algorithms.mapping.occupancy_grid import PatchCells
from robrain.algorithms.slam.map_patch import to_message
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP, ROBOT_MAP_WHOLE
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE
from robrain.protocol.messages.team.team_messages import COORDINATOR_ALIVE, COORDINATOR_STATE
from robrain.protocol.model.grid_geometry import FREE, GridGeometry
from tests.system.conftest import endpoint_of
from tests.waiting import PATIENCE_S, has_ended, until

pytestmark = pytest.mark.system


def planner_of(pid: int) -> int:
    """Process id of a coordinator's planner; 0 if there is none."""
    with suppress(psutil.NoSuchProcess):
        for child in psutil.Process(pid).children():
            if any("worker_main" in word for word in child.cmdline()):
                return int(child.pid)
    return 0


def test_a_map_that_comes_as_soon_as_it_is_live_is_taken_in(commands, hub, wire):
    summaries = Inbox()
    wire.subscribe(summaries, COORDINATOR_STATE)
    presence = wire.watch(COORDINATOR_ALIVE)
    cells = PatchCells(0, 0, np.full((10, 10), FREE), 1)
    patch = to_message("r1", GridGeometry(0.1, 0.0, 0.0, 40, 40), cells)
    # A patch may be taken in before the token of its robot is; as that appears, the robot is asked for its whole map.
    wire.answer(ROBOT_MAP_WHOLE, lambda _: patch, robot="r1")
    wire.token(ROBOT_ALIVE, robot="r1")
    commands.start("coordinator", "--connect", endpoint_of(hub))
    until(lambda: (list(presence.changes()), presence.present)[1])
    wire.publisher(ROBOT_MAP, robot="r1").put(patch)
    known_m2 = until(lambda: [m for one in summaries.drain() if (m := one.message.known_area_m2) > 0.0])
    assert known_m2[-1] == pytest.approx(1.0)


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGINT, signal.SIGKILL])
def test_however_it_ends_its_planner_does_too_and_nobody_complains(commands, hub, how):
    coordinator = commands.coordinator(endpoint_of(hub))
    planner = until(lambda: planner_of(coordinator.pid))
    coordinator.send_signal(how)
    said, _ = coordinator.communicate(timeout=PATIENCE_S)  # until the planner has closed it, too
    assert said == ""
    assert coordinator.returncode == (-signal.SIGKILL if how is signal.SIGKILL else 0)
    until(lambda: has_ended(planner))
