"""The dashboard as an operator uses it, on a team of real processes: arena, coordinator and agents."""

import time
from collections.abc import Iterator

import pytest
from playwright.sync_api import Page, expect

from robrain.protocol.model.geometry import wrap_angle_rad
from robrain.protocol.wire.clock import WallClock
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.messages import ArenaTruth, RobotTruth
from robrain.protocol.wire.session import open_session
from robrain.protocol.wire.topics import ARENA_TRUTH
from tests.system.browser import chromium, click_on, colors_in, keep, open_page, picture_of, wait_for

pytestmark = pytest.mark.system

ROBOTS = ("r1", "r2")
TASK_S = 60.0
STOPPED_M = 0.01
STANDS_S = 1.0


class Truth:
    """Where the arena says that the robots are."""

    def __init__(self, endpoint: Endpoint) -> None:
        self._inbox = Inbox()
        self._told: ArenaTruth | None = None
        endpoint.subscribe(self._inbox, ARENA_TRUTH)

    def robots(self) -> dict[str, RobotTruth]:
        for received in self._inbox.drain():
            self._told = received.message
        return {robot.robot: robot for robot in self._told.robots} if self._told is not None else {}

    def way_m(self) -> float:
        """How far all robots have come together."""
        return sum(robot.distance_m for robot in self.robots().values())


@pytest.fixture
def team(commands) -> Iterator[tuple[str, Truth]]:
    """The page's address, and the truth."""
    process = commands.start("up", "arena_small", "--robots", "2", "--seed", "7", "--port", "0")
    hub = commands.line_with(process, "hub: ").split()[1]
    url = commands.line_with(process, "dashboard: ").split()[1]
    session = open_session(mode="client", connect=(hub,))
    endpoint = Endpoint(session, "default", WallClock(), Drive.LIVE)
    yield url, Truth(endpoint)
    endpoint.close()
    session.close()


def test_operator_sees_asks_tasks_and_halts_a_live_team(team: tuple[str, Truth]) -> None:
    url, truth = team
    with chromium() as context:
        page, errors = open_page(context, url)
        _team_is_drawn_and_moves(page)
        _function_is_called_by_its_form(page)
        _task_is_added_by_a_click_and_done(page)
        _robot_is_driven_by_a_held_key(page, truth)
        _halt_stops_the_wheels(page, truth)
        assert errors == []


def _team_is_drawn_and_moves(page: Page) -> None:
    for robot in ROBOTS:
        expect(page.get_by_test_id(f"robot-{robot}-contact")).to_have_text("● up")
    before = wait_for(lambda: picture_of(page), lambda picture: colors_in(picture) > 20, "a picture")
    wait_for(lambda: picture_of(page), lambda picture: bool((picture != before).any()), "another picture")
    page.get_by_role("tab", name="Robot", exact=True).click()
    place = page.get_by_test_id("robot-r1-place").or_(page.get_by_test_id("robot-r2-place"))
    first = place.inner_text()
    expect(place).not_to_have_text(first)


def _function_is_called_by_its_form(page: Page) -> None:
    click_on(page, "[data-testid='plugin-home']")
    expect(page.get_by_test_id("plugin-card")).to_contain_text("home")
    _choose(page, "Function", "learn")
    call = page.get_by_role("button", name="Call", exact=True)
    call.click()
    expect(page.get_by_test_id("call-result")).to_contain_text("charger.x_m: expected a number, got nothing")
    _fill(page, "charger x (m)", "1.5")
    _fill(page, "charger y (m)", "2.5")
    call.click()
    expect(page.get_by_test_id("call-result")).to_contain_text("✓ home.learn: null")
    _choose(page, "Function", "chargers")
    call.click()
    expect(page.get_by_test_id("call-result")).to_contain_text('"x_m": 1.5')
    # What the robot refuses is told in its own words.
    click_on(page, "[data-testid='plugin-driver']")
    _choose(page, "Function", "drive_path")
    _fill(page, "points", "[]")
    call.click()
    expect(page.get_by_test_id("call-result")).to_contain_text("expected at least one point, got none")
    keep(page, "dashboard-plugin")


def _task_is_added_by_a_click_and_done(page: Page) -> None:
    page.get_by_role("tab", name="Tasks", exact=True).click()
    told = page.get_by_test_id("task-told")
    for x, y in ((400, 330), (300, 300), (500, 380), (420, 260)):  # some may lie in what is not known yet
        page.get_by_role("button", name="Add by a click on the map", exact=True).click()
        page.get_by_role("button", name="Click on the map now, or here to cancel", exact=True).wait_for()
        page.mouse.click(x, y)
        wait_for(told.inner_text, lambda said: said.startswith(("✓", "✕")), "an answer to the task")
        if told.inner_text().startswith("✓"):
            break
    task = told.inner_text().split()[1]
    assert task.startswith("visit-")
    state = page.get_by_test_id(f"task-{task}-state")
    click_on(page, f"[data-rb='why {task}']")
    expect(page.get_by_test_id("why-now")).to_be_visible()
    keep(page, "dashboard-why")
    page.get_by_role("button", name="Close", exact=True).click()
    expect(state).to_have_text("✓ done", timeout=1000 * TASK_S)
    expect(page.get_by_test_id("gantt")).to_be_visible()
    keep(page, "dashboard-tasks")


def _robot_is_driven_by_a_held_key(page: Page, truth: Truth) -> None:
    page.get_by_role("tab", name="Robot", exact=True).click()
    robot = page.get_by_test_id("selected-robot").inner_text()
    page.get_by_text("Drive by hand", exact=True).click()
    page.get_by_role("checkbox", name="Armed").check()
    expect(page.get_by_test_id("teleop")).to_contain_text("Armed")
    before_rad = truth.robots()[robot].pose.yaw_rad
    page.keyboard.down("a")
    expect(page.get_by_test_id("teleop")).to_contain_text(f"{robot} is driven")
    wait_for(lambda: _turned_rad(truth, robot, before_rad), lambda turned: turned > 0.3, "the robot's turning left")
    page.keyboard.up("a")
    expect(page.get_by_test_id("teleop")).to_contain_text(f"{robot} stands")
    page.get_by_role("checkbox", name="Armed").uncheck()


def _turned_rad(truth: Truth, robot: str, before_rad: float) -> float:
    return wrap_angle_rad(truth.robots()[robot].pose.yaw_rad - before_rad)


def _halt_stops_the_wheels(page: Page, truth: Truth) -> None:
    page.get_by_role("tab", name="Team", exact=True).click()
    page.get_by_role("button", name="EMERGENCY HALT", exact=True).click()
    expect(page.get_by_test_id("stopped")).to_have_text("r1, r2")
    expect(page.get_by_test_id("not-stopped")).to_have_count(0)
    expect(page.get_by_test_id("robot-r1-contact")).to_have_text("■ halted")
    time.sleep(STANDS_S)
    before_m = truth.way_m()
    time.sleep(STANDS_S)
    assert before_m > 0
    assert truth.way_m() - before_m < STOPPED_M
    keep(page, "dashboard-halted")
    page.get_by_role("button", name="Resume after halt …", exact=True).click()
    page.get_by_role("button", name="Resume all robots", exact=True).click()
    expect(page.get_by_test_id("robot-r1-contact")).to_have_text("● up")


def _fill(page: Page, label: str, value: str) -> None:
    """Type into the input that stands beside a label; viser gives it no name of its own."""
    page.get_by_text(label, exact=True).locator("xpath=ancestor::div[.//input][1]//input").fill(value)


def _choose(page: Page, label: str, option: str) -> None:
    page.get_by_text(label, exact=True).last.locator("xpath=ancestor::div[.//input][1]//input").first.click()
    page.get_by_role("option", name=option, exact=True).click()
