import io

import numpy as np
import pytest
from PIL import Image

from robrain.protocol.messages.team.arena_messages import ARENA_CAMERA, ARENA_SENSE
from robrain.protocol.model.geometry import Pose2D
from tests.plugins.behavior.errands import Errands


@pytest.fixture
def run():
    one = Errands("counter", starts={"r2": Pose2D(3.0, 1.5, 0.0)})
    one.run(0.1)
    yield one
    one.close()


def test_each_robot_has_a_camera_of_its_own_that_is_asked_over_the_wire(run):
    first, second = (run.wire.ask(ARENA_CAMERA, robot=name) for name in ("r1", "r2"))
    assert first != second
    assert np.asarray(Image.open(io.BytesIO(first))).shape == (120, 160, 3)
    assert first == run.arena.picture("r1")


def test_a_board_measures_what_there_is_with_the_noise_of_a_mote(run):
    values = run.wire.ask(ARENA_SENSE, robot="r1")
    assert set(values) == {"temperature_c", "light_lx", "humidity_pct"}
    assert values == run.arena.measurement("r1")
    run.run(0.02)
    later = run.arena.measurement("r1")
    assert later != values
    assert later["temperature_c"] == pytest.approx(values["temperature_c"], abs=1.0)


def test_who_looks_changes_nothing():
    digests = []
    for looks in (0, 7):
        one = Errands("visit", seed=4)
        for _ in range(looks):
            one.run(0.2)
            one.wire.ask(ARENA_CAMERA, robot="r1")
            one.wire.ask(ARENA_SENSE, robot="r1")
        one.run(3.0 - 0.2 * looks)
        digests.append(one.close())
    assert digests[0] == digests[1]
