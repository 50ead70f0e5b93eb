"""Where robots charge and started, as they tell: asked few at a time, and never waited for."""

from collections import Counter

import pytest

from robrain.coordinator.planning.chargers import ASKED_MAX, KnownChargers
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.wire.clock import VirtualClock, to_ns
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from robrain.protocol.wire.topics import ROBOT_CALL


class Homes:
    """Robots that tell of their chargers and where they started."""

    def __init__(self, session):
        self.wire = Endpoint(session, "default", VirtualClock(), Drive.LOCKSTEP)
        self.known = KnownChargers(self.wire)
        self.asked = Counter()
        self.robots = {}

    def robot(self, name):
        self.robots[name] = Point2D(1.0, 2.0)
        for function, told in (("chargers", [{"x_m": 3.0, "y_m": 4.0}]), ("start", Point2D(5.0, 6.0))):
            self.wire.answer(
                ROBOT_CALL, lambda _, told=told: self._tell(name, told), robot=name, plugin="home", function=function
            )

    def follow(self, at_s):
        before = self.asked.total()
        self.known.follow(self.robots, to_ns(at_s))
        return self.asked.total() - before

    def _tell(self, name, told):
        self.asked[name] += 1
        return told


@pytest.fixture
def homes():
    with open_lockstep_session() as session:
        homes = Homes(session)
        yield homes
        homes.wire.close()


def test_robot_tells_of_its_chargers_and_where_it_started(homes):
    homes.robot("r1")
    homes.follow(0.0)
    homes.follow(0.5)
    assert [charger.place for charger in homes.known.of["r1"]] == [Point2D(3.0, 4.0)]
    assert homes.known.home["r1"] == Point2D(5.0, 6.0)


def test_large_team_is_asked_in_turns_so_that_no_step_is_long(homes):
    for number in range(2 * ASKED_MAX + 5):
        homes.robot(f"r{number}")
    asked = [homes.follow(0.5 * look) for look in range(4)]
    assert asked == [2 * ASKED_MAX, 2 * ASKED_MAX, 10, 0]
    assert len(homes.known.of) == len(homes.robots)


def test_robot_that_comes_again_is_asked_at_once(homes):
    homes.robot("r1")
    homes.follow(0.0)
    homes.follow(0.5)
    homes.known.came("r1")
    assert homes.follow(1.0) == 2
