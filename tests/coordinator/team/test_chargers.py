"""Where robots charge and started, as they tell: asked few at a time, and never waited for."""

from collections import Counter

import pytest

from robrain.coordinator.team.chargers import ASKED_MAX, Charger, KnownChargers
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.wire.endpoint import Drive, Endpoint


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
def homes(lockstep_session):
    homes = Homes(lockstep_session)
    yield homes
    homes.wire.close()


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


def test_robot_that_does_not_answer_is_asked_ever_less_often(homes):
    homes.robots["r1"] = Point2D(1.0, 2.0)
    asked_s = []
    homes.known._wire.ask_into = lambda *_, function, **__: asked_s.append((at_s, function))
    for at_s in range(250):
        homes.follow(at_s)
    assert [at_s for at_s, function in asked_s if function == "chargers"] == [0, 2, 6, 14, 30, 62, 122, 182, 242]
    assert [at_s for at_s, function in asked_s if function == "start"] == [0, 2, 6, 14, 30, 62, 122, 182, 242]
    assert homes.known.of == {}
    assert homes.known.home["r1"] == Point2D(1.0, 2.0), "where it was first seen"


def test_only_a_robot_with_a_home_is_asked_and_one_that_has_none_any_more_has_no_chargers(homes):
    plugins = {"r1": frozenset({"home", "visit"}), "r2": frozenset({"visit"})}
    homes.known = KnownChargers(homes.wire, plugins)
    homes.robot("r1")
    homes.robot("r2")
    homes.follow(0.0)
    homes.follow(0.5)
    assert homes.asked == {"r1": 2}
    assert set(homes.known.of) == {"r1"}
    plugins["r1"] = frozenset({"visit"})
    homes.follow(1.0)
    assert homes.known.of == {}


def test_robot_that_has_not_told_its_plugins_is_asked_two_seconds_after_it_was_first_seen(homes):
    homes.known = KnownChargers(homes.wire, {"r1": None})
    homes.robot("r1")
    assert [homes.follow(at_s) for at_s in (5.0, 6.99, 7.0)] == [0, 0, 2]
    homes.known.came("r1")
    assert [homes.follow(at_s) for at_s in (8.0, 9.99, 10.0)] == [0, 0, 2]


def test_answer_that_cannot_be_read_leaves_what_is_known(homes):
    homes.robots["r1"] = Point2D(1.0, 2.0)
    for function in ("chargers", "start"):
        homes.wire.answer(ROBOT_CALL, lambda _: "here", robot="r1", plugin="home", function=function)
    homes.follow(0.0)
    homes.follow(0.5)
    assert homes.known.of == {}
    assert homes.known.home == {"r1": Point2D(1.0, 2.0)}


def test_charger_may_have_a_heading(homes):
    homes.robots["r1"] = Point2D(1.0, 2.0)
    told = [{"x_m": 3.0, "y_m": 4.0, "yaw_rad": 1.5}, {"x_m": 5.0, "y_m": 6.0}]
    homes.wire.answer(ROBOT_CALL, lambda _: told, robot="r1", plugin="home", function="chargers")
    homes.follow(0.0)
    homes.follow(0.5)
    assert homes.known.of["r1"] == (Charger(Point2D(3.0, 4.0), 1.5), Charger(Point2D(5.0, 6.0), None))
