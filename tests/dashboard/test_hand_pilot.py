"""The dashboard renews a lease only while a browser says that a button is held, and gives the robot back otherwise."""

from collections.abc import Mapping
from typing import Any

import pytest

from robrain.dashboard.server.hand_pilot import HELD_S, HandPilot
from robrain.protocol.answers.hand_control import HandControl
from robrain.protocol.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.model.geometry import Twist2D
from tests.waiting import until

AHEAD, LEFT = Twist2D(forward_m_s=0.2), Twist2D(yaw_rad_s=0.5)


class Driver:
    """A robot's driver, as the wire shows it; keeps what was asked."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, Mapping[str, object]]] = []
        self.fails: Exception | None = None
        self.lease = 0
        self.has_lapsed = False

    def __call__(self, function: str, arguments: Mapping[str, object]) -> Any:
        if self.fails is not None:
            raise self.fails
        self.asked.append((function, arguments))
        if function == "acquire_hand_lease":
            self.lease, self.has_lapsed = self.lease + 1, False
            return {"lease": self.lease, "lease_s": 0.1, "renew_s": 0.025}
        if arguments["lease"] != self.lease or self.has_lapsed:
            raise CallError(ErrorCode.REFUSED, "the lease has lapsed")
        return None

    def moves(self) -> list[tuple[object, object]]:
        """Forward speed and yaw rate of each `move` since the last call."""
        asked, self.asked = self.asked, []
        return [(each["forward_m_s"], each["yaw_rad_s"]) for function, each in asked if function == "move"]


@pytest.fixture
def driver():
    return Driver()


@pytest.fixture
def pilot(driver):
    return HandPilot(HandControl(driver, "ann"), "r1")


def test_lease_is_taken_once_and_renewed_while_a_button_is_held(pilot, driver):
    for now_s in (0.0, 0.05, 0.1):
        pilot.press("w", AHEAD, now_s)
        assert pilot.step(now_s)
    assert [function for function, _ in driver.asked] == ["acquire_hand_lease", "move", "move", "move"]
    assert driver.asked[0][1] == {"by": "ann"}
    assert driver.moves() == [(0.2, 0.0)] * 3
    assert (pilot.status, pilot.has_failed) == ("is driving", False)


def test_browser_that_says_nothing_more_has_the_robot_stopped_at_once_and_once(pilot, driver):
    pilot.press("w", AHEAD, 0.0)
    assert pilot.step(HELD_S)
    driver.moves()
    assert not pilot.step(HELD_S + 0.001)
    assert not pilot.step(HELD_S + 1.0)
    assert driver.moves() == [(0.0, 0.0)]
    assert pilot.status == "stopped"


def test_two_buttons_add_up_and_opposite_ones_are_none(pilot, driver):
    pilot.press("w", AHEAD, 0.0)
    pilot.press("a", LEFT, 0.0)
    pilot.step(0.0)
    assert driver.moves() == [(0.2, 0.5)]
    pilot.press("s", Twist2D(forward_m_s=-0.2), 0.0)
    pilot.press("d", Twist2D(yaw_rad_s=-0.5), 0.0)
    assert not pilot.step(0.0)
    assert driver.moves() == [(0.0, 0.0)]


def test_lease_that_has_lapsed_is_taken_again_while_the_button_is_held(pilot, driver):
    pilot.press("w", AHEAD, 0.0)
    pilot.step(0.0)
    driver.has_lapsed = True
    pilot.press("w", AHEAD, 1.0)
    assert pilot.step(1.0)
    # What was asked for before the wait moves nothing: the button may have been released meanwhile.
    assert [function for function, _ in driver.asked] == ["acquire_hand_lease", "move", "move", "acquire_hand_lease"]
    pilot.press("w", AHEAD, 1.025)
    assert pilot.step(1.025)
    assert [function for function, _ in driver.asked][4:] == ["move"]


@pytest.mark.parametrize("error", [CallError(ErrorCode.BUSY, "bob drives"), NobodyThere("nobody answers")])
def test_robot_that_does_not_obey_is_said_and_not_asked_again_until_a_button_is_pressed(pilot, driver, error):
    driver.fails = error
    pilot.press("w", AHEAD, 0.0)
    assert not pilot.step(0.0)
    assert (pilot.status, pilot.has_failed) == (str(error), True)
    driver.fails = None
    assert not pilot.step(0.01)
    assert driver.asked == []
    pilot.press("w", AHEAD, 0.02)
    assert pilot.step(0.02)
    assert (pilot.status, pilot.has_failed) == ("is driving", False)


def test_end_gives_the_robot_back_and_hears_no_button_any_more(pilot, driver):
    pilot.press("w", AHEAD, 0.0)
    pilot.step(0.0)
    driver.moves()
    pilot.end()
    pilot.press("w", AHEAD, 0.0)
    pilot.step(0.0)
    assert driver.moves() == [(0.0, 0.0)]


def test_thread_renews_by_itself_and_ends(pilot, driver):
    pilot._control.renew_s = 0.001
    pilot.start()
    pilot.press("w", AHEAD, float("inf"))  # held for ever
    until(lambda: len(driver.asked) > 3, "the lease is not renewed")
    pilot.end()
    until(lambda: driver.asked and driver.asked[-1][1].get("forward_m_s") == 0.0, "the robot is not given back")
