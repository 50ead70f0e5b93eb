"""The dashboard as an operator uses it, on a team of real processes: arena, coordinator and agents."""

import itertools
import re
import shutil
import time
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Locator, Page, expect

from robrain.protocol.model.geometry import wrap_angle_rad
from tests.system.browser import CLOSE_NOTICES, click_on, keep, notices, open_page, wait_for, window
from tests.system.hanging import stopped
from tests.system.live_team import LiveTeam, live_team
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.system

ROBOTS = ("r1", "r2")
STOPPED_M = 0.01
STANDS_S = 1.0
TYPING_S = 0.15
"""From one field to the next: viser sends what is typed each 50 ms, and of what came in between the last alone."""
IS_INERT = "field => field.closest('[inert]') !== null"


def test_operator_sees_asks_tasks_drives_and_halts_a_live_team(
    tmp_path_factory: pytest.TempPathFactory, browser: Browser
) -> None:
    sweep = tmp_path_factory.mktemp("live") / "sweep"  # a short path: notices cut long ones
    shutil.copytree(Path(__file__).parents[3] / "examples" / "08_your_own_task", sweep)
    with live_team(sweep.parent, "arena_small", "--seed", "7", robots=ROBOTS) as team, window(browser) as context:
        page, errors = open_page(context, team.url)
        for robot in ROBOTS:
            expect(page.get_by_test_id(f"robot-{robot}-contact")).to_have_text("● up")
        page.get_by_role("tab", name="Robot", exact=True).click()
        _function_is_called_by_its_form(page)
        _task_is_added_by_a_click_and_done(page)
        _robot_is_driven_by_a_held_key(page, team)
        _halt_stops_the_wheels(page, team)
        _plugin_is_unloaded_loaded_and_reloaded_by_its_buttons(page)
        _task_is_called_off_by_its_button(page, team)
        _kind_of_task_that_only_one_robot_knows_is_asked_for_by_form(page, sweep)
        _robot_that_does_not_acknowledge_a_halt_is_named_until_it_does(page, team)
        assert errors == []


def _plugin_is_unloaded_loaded_and_reloaded_by_its_buttons(page: Page) -> None:
    page.get_by_role("tab", name="Robot", exact=True).click()
    chip = page.get_by_test_id("plugin-counter")
    card = page.get_by_test_id("plugin-card")
    click_on(page, "[data-testid='plugin-counter']")
    expect(card).to_contain_text("counter")
    before_s, answered_s = _seconds_since_start(page), time.monotonic()
    page.get_by_role("button", name="Unload", exact=True).click()
    _is_reported(page, "unload counter", "done")
    expect(chip).to_have_count(0)
    expect(card).to_have_count(0)
    expect(page.get_by_role("button", name="Call", exact=True)).to_be_disabled()

    expect(_field(page, "Name or path")).to_have_value("counter")
    page.get_by_role("button", name="Load", exact=True).click()
    _is_reported(page, "load counter", "done")
    expect(chip).to_have_attribute("title", re.compile("^active"))
    click_on(page, "[data-testid='plugin-counter']")
    asked_s = time.monotonic()
    loaded_s = _seconds_since_start(page)
    assert loaded_s < before_s + asked_s - answered_s  # the old one would have counted on

    time.sleep(1.0)
    page.get_by_role("button", name="Reload", exact=True).click()
    _is_reported(page, "reload counter", "done")
    expect(chip).to_have_attribute("title", re.compile("^active"))
    keep(page, "dashboard-plugins")
    # What cannot be loaded is told in the robot's own words.
    _fill(page, "Name or path", "no_such_plugin")
    page.get_by_role("button", name="Load", exact=True).click()
    _is_reported(page, "load no_such_plugin", "no_such_plugin")


def _task_is_called_off_by_its_button(page: Page, team: LiveTeam) -> None:
    page.get_by_role("tab", name="Tasks", exact=True).click()
    here = team.robots()["r1"].pose
    page.get_by_text("Coordinates and options", exact=True).click()
    _fill(page, "x (m)", f"{here.x_m:.2f}")
    _fill(page, "y (m)", f"{here.y_m:.2f}")
    _fill(page, "service (s)", "600")
    before = _said_of_tasks(page)
    page.get_by_role("button", name="Add task at these coordinates", exact=True).click()
    said = _answer_to_task(page, before)
    assert said.startswith("✓")
    task = said.split()[1]
    click_on(page, f"[data-rb='cancel {task}']")
    expect(page.get_by_test_id(f"task-{task}-state")).to_have_text("⊘ cancelled")
    expect(page.locator(f"[data-rb='cancel {task}']")).to_have_count(0)
    expect(page.locator("table[data-testid='tasks']")).to_contain_text("cancelled on the dashboard")


def _kind_of_task_that_only_one_robot_knows_is_asked_for_by_form(page: Page, plugin_folder: Path) -> None:
    page.get_by_role("tab", name="Robot", exact=True).click()
    _fill(page, "Name or path", str(plugin_folder))
    page.get_by_role("button", name="Load", exact=True).click()
    _is_reported(page, f"load {plugin_folder}", "done")
    page.get_by_role("tab", name="Tasks", exact=True).click()
    until(lambda: "mow" in _options(page, "Kind"), "the form does not know the kind", pause_s=0.5)
    page.get_by_role("option", name="mow", exact=True).click()
    _unfold(page, "Coordinates and options", "width (m)")
    for label, value in (("x (m)", "3"), ("y (m)", "3"), ("width (m)", "-1"), ("height (m)", "0.4")):
        _fill(page, label, value)
    before = _said_of_tasks(page)
    page.get_by_role("button", name="Add task at these coordinates", exact=True).click()
    assert "width_m: -1.0 is less than or equal to the minimum of 0" in _answer_to_task(page, before)
    keep(page, "dashboard-own-kind")
    _fill(page, "width (m)", "1")
    before = _said_of_tasks(page)
    page.get_by_role("button", name="Add task at these coordinates", exact=True).click()
    said = _answer_to_task(page, before)
    assert said.startswith("✓ mow-")
    expect(page.get_by_test_id(f"task-{said.split()[1]}-state")).to_contain_text("done", timeout=PATIENCE_S * 1000)


def _options(page: Page, label: str) -> list[str]:
    """Open a dropdown; what there is to choose."""
    page.keyboard.press("Escape")
    page.get_by_text(label, exact=True).last.locator("xpath=ancestor::div[.//input][1]//input").first.click()
    return page.get_by_role("option").all_inner_texts()


def _robot_that_does_not_acknowledge_a_halt_is_named_until_it_does(page: Page, team: LiveTeam) -> None:
    page.get_by_role("tab", name="Team", exact=True).click()
    expect(page.get_by_test_id("robot-r2-contact")).to_have_text("● up")
    with stopped([team.process_of("r2")]):
        page.get_by_role("button", name="EMERGENCY HALT", exact=True).click()
        expect(page.get_by_test_id("stopped")).to_have_text("r1")
        expect(page.get_by_test_id("not-stopped")).to_have_text("r2")
        expect(page.get_by_test_id("robot-r2-contact")).to_have_text(re.compile("^(◐ silent|✕ lost)"))
        expect(page.get_by_test_id("halt-state")).to_contain_text("1 of 2 robots report that they are halted")
        keep(page, "dashboard-not-acknowledged")
        # Its wheels stand all the same: the firmware hears no more commands.
        team.come_to_a_stand(STANDS_S, STOPPED_M)
        before_m = team.robots()["r2"].distance_m
        time.sleep(STANDS_S)
        assert team.robots()["r2"].distance_m - before_m < STOPPED_M
    expect(page.get_by_test_id("stopped")).to_have_text("r1, r2")
    expect(page.get_by_test_id("not-stopped")).to_have_count(0)
    _resume(page)


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
    said = ""
    ends_s = time.monotonic() + PATIENCE_S
    for x, y in itertools.cycle(((400, 330), (300, 300), (500, 380), (420, 260))):  # some may not be known yet
        assert time.monotonic() < ends_s, said
        page.get_by_role("button", name="Click on the map to add a task", exact=True).click()
        page.get_by_role("button", name="Now click on the map (or here to cancel)", exact=True).wait_for()
        before = _said_of_tasks(page)
        page.mouse.click(x, y)
        said = _answer_to_task(page, before)
        if said.startswith("✓"):
            break
    task = said.split()[1]
    assert task.startswith("visit-")
    state = page.get_by_test_id(f"task-{task}-state")
    click_on(page, f"[data-rb='why {task}']")
    expect(page.get_by_test_id("why-now")).to_be_visible()
    keep(page, "dashboard-why")
    page.get_by_role("button", name="Close", exact=True).click()
    expect(state).to_have_text("✓ done", timeout=1000 * PATIENCE_S)
    expect(page.get_by_test_id("gantt")).to_be_visible()
    keep(page, "dashboard-tasks")


def _said_of_tasks(page: Page) -> str:
    told = page.get_by_test_id("task-told")
    return told.inner_text() if told.count() else ""


def _answer_to_task(page: Page, before: str) -> str:
    """What is said of the task that was sent now; until that comes, the page shows what was said of the last one."""
    return wait_for(
        lambda: _said_of_tasks(page),
        lambda said: said != before and said.startswith(("✓", "✕")),
        "an answer to the task",
    )


def _robot_is_driven_by_a_held_key(page: Page, team: LiveTeam) -> None:
    page.get_by_role("tab", name="Robot", exact=True).click()
    robot = page.get_by_test_id("selected-robot").inner_text()
    page.get_by_text("Drive by hand", exact=True).click()
    page.get_by_role("checkbox", name="Armed").check()
    expect(page.get_by_test_id("teleop")).to_contain_text("Armed")
    before_rad = team.robots()[robot].pose.yaw_rad
    page.keyboard.down("a")
    expect(page.get_by_test_id("teleop")).to_contain_text(f"{robot} is driving")
    wait_for(lambda: _turned_rad(team, robot, before_rad), lambda turned: turned > 0.3, "the robot's turning left")
    page.keyboard.up("a")
    expect(page.get_by_test_id("teleop")).to_contain_text(f"{robot} stopped")
    page.get_by_role("checkbox", name="Armed").uncheck()


def _turned_rad(team: LiveTeam, robot: str, before_rad: float) -> float:
    return wrap_angle_rad(team.robots()[robot].pose.yaw_rad - before_rad)


def _halt_stops_the_wheels(page: Page, team: LiveTeam) -> None:
    page.get_by_role("tab", name="Team", exact=True).click()
    page.get_by_role("button", name="EMERGENCY HALT", exact=True).click()
    expect(page.get_by_test_id("stopped")).to_have_text("r1, r2")
    expect(page.get_by_test_id("not-stopped")).to_have_count(0)
    expect(page.get_by_test_id("robot-r1-contact")).to_have_text("■ halted")
    team.come_to_a_stand(STANDS_S, STOPPED_M)
    before_m = team.driven_m()
    time.sleep(STANDS_S)
    assert before_m > 0
    assert team.driven_m() - before_m < STOPPED_M
    keep(page, "dashboard-halted")
    _resume(page)


def _resume(page: Page) -> None:
    page.get_by_role("button", name="Resume after halt …", exact=True).click()
    page.get_by_role("button", name="Resume all robots", exact=True).click()
    for robot in ROBOTS:
        expect(page.get_by_test_id(f"robot-{robot}-contact")).to_have_text("● up")


def _seconds_since_start(page: Page) -> float:
    """What the selected counter says when it is asked by its form."""
    _choose(page, "Function", "seconds")
    page.get_by_role("button", name="Call", exact=True).click()
    result = page.get_by_test_id("call-result")
    expect(result).to_contain_text("✓ counter.seconds")
    return float(result.inner_text().rpartition(":")[2])


def _is_reported(page: Page, title: str, said: str) -> None:
    """A notice of this title came, and is closed; it closes by itself after six seconds, seen or not."""
    wait_for(
        lambda: [text for text in notices(page) if title in text],
        lambda texts: any(said in text for text in texts),
        f"the notice {title}",
    )
    page.evaluate(CLOSE_NOTICES)
    expect(page.locator(".mantine-Notification-root").filter(has_text=title)).to_have_count(0)


def _fill(page: Page, label: str, value: str) -> None:
    _field(page, label).fill(value)
    # In the page's own time: on a busy computer two fields are else sent at once, of which viser keeps the last.
    page.evaluate("ms => new Promise(done => setTimeout(done, ms))", 1000 * TYPING_S)


def _unfold(page: Page, title: str, label: str) -> None:
    """Open a folder of the form unless it is open. What a closed one holds is inert, yet may count as visible."""
    field = _field(page, label)
    field.wait_for(state="attached")
    if field.evaluate(IS_INERT):
        page.get_by_text(title, exact=True).click()
    until(lambda: not field.evaluate(IS_INERT), f"{title} stays closed", pause_s=0.2)


def _field(page: Page, label: str) -> Locator:
    """The input that stands beside a label; viser gives it no name of its own."""
    return page.get_by_text(label, exact=True).locator("xpath=ancestor::div[.//input][1]//input")


def _choose(page: Page, label: str, option: str) -> None:
    page.get_by_text(label, exact=True).last.locator("xpath=ancestor::div[.//input][1]//input").first.click()
    page.get_by_role("option", name=option, exact=True).click()
