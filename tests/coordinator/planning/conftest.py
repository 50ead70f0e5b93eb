"""A planner as the live coordinator has it."""

import threading

import pytest

from robrain.coordinator.planning.live_planner import LivePlanner


@pytest.fixture
def made():
    return threading.Event()


@pytest.fixture
def planner(made):
    found = LivePlanner(made.set)
    yield found
    found.close()
