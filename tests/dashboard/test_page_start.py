"""What the page of a live team loads before it is served: a person waits for it."""

import subprocess
import sys
import threading

import msgspec
import numpy as np
import pytest

from robrain.algorithms.mapping.occupancy_grid import PatchCells
from robrain.algorithms.slam.map_patch import to_message
from robrain.dashboard.state import live_source
from robrain.dashboard.state.live_source import MapLoading
from robrain.protocol.border.border import Received
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP
from robrain.protocol.messages.team.arena_messages import ARENA_CLOCK, ArenaClock
from robrain.protocol.model.grid_geometry import GridGeometry
from tests.waiting import PATIENCE_S

SLOW = ("numba", "llvmlite", "scipy", "pandas", "matplotlib", "PIL", "mcap", "pymunk")
LOADED = """
import sys
import robrain.cli, robrain.deploy.recordings.replaying
from robrain.dashboard import Dashboard
from robrain.protocol.clock import VirtualClock
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
session = open_lockstep_session()
team = Endpoint(session, "default", VirtualClock(), Drive.LOCKSTEP)
page = Dashboard(team, port=0)
for now_s in (0.0, 1.5, 3.0):
    page.step(now_s)
print(*sorted({name.partition(".")[0] for name in sys.modules}))
page.close()
team.close()
session.close()
"""
CLOCK = Received(ARENA_CLOCK, ARENA_CLOCK.key("default"), {"team": "default"}, ArenaClock(sim_time_s=0.1))


@pytest.fixture
def loaded(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """What merges maps is loaded once this is set."""
    event = threading.Event()
    monkeypatch.setattr(live_source, "MERGER", "robrain.not_loaded_yet")
    monkeypatch.setattr(live_source, "load", lambda _patch: event.wait(PATIENCE_S))
    return event


def patch(columns: int = 2) -> Received:
    message = to_message("r1", GridGeometry(0.1, 0.0, 0.0, 8, 8), PatchCells(0, 0, np.zeros((2, columns), np.int8), 1))
    return Received(ROBOT_MAP, ROBOT_MAP.key("default", robot="r1"), {"team": "default", "robot": "r1"}, message)


@pytest.mark.slow
def test_page_is_served_and_drawn_without_what_loads_slowly() -> None:
    done = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert {"robrain", "viser", "numpy"} <= loaded
    assert not loaded & set(SLOW)


def test_patches_wait_while_what_merges_them_loads_and_other_messages_do_not(loaded: threading.Event) -> None:
    loading, first, second, third = MapLoading(), patch(2), patch(3), patch(4)
    assert list(loading.let_through([CLOCK])) == [CLOCK]
    assert list(loading.let_through([first, CLOCK])) == [CLOCK]
    assert list(loading.let_through([second])) == []
    loaded.set()
    loading.close()
    assert list(loading.let_through([third, CLOCK])) == [first, second, third, CLOCK]
    assert list(loading.let_through([CLOCK, third])) == [CLOCK, third]


def test_patches_that_are_too_many_are_counted(loaded: threading.Event, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_source, "HELD_PATCHES", 2)
    loading, patches = MapLoading(), [patch(columns) for columns in (2, 3, 4)]
    assert list(loading.let_through(patches)) == []
    assert loading.dropped == 1
    loaded.set()
    loading.close()
    assert list(loading.let_through([])) == patches[1:]


def test_loading_makes_the_merging_of_maps_ready_whatever_the_patch() -> None:
    live_source.load(patch().message)
    live_source.load(msgspec.structs.replace(patch().message, cells=b""))
