"""The dashboard as a person sees it: a real server, a real wire, a real Chromium."""

import re
import threading
import time
from collections.abc import Iterator
from queue import Queue

import pytest
from playwright.sync_api import Browser, Page, expect

from robrain.dashboard import run_dashboard
from robrain.protocol.messages.team.team_messages import Halt
from robrain.protocol.wire.endpoint import Endpoint
from tests.system.browser import click_on, colors_in, keep, open_page, picture_of, wait_for, window
from tests.system.conftest import member_at
from tests.system.fake_team import FakeTeam
from tests.system.stepped_dashboard import Stepped
from tests.waiting import PATIENCE_S

pytestmark = pytest.mark.system

WAIT_S = PATIENCE_S


class Stoppable:
    """A dashboard with a session of its own, as `robrain dashboard` runs it."""

    def __init__(self, endpoint: Endpoint) -> None:
        self._stop = threading.Event()
        ready: Queue[str] = Queue()
        arguments = (endpoint, "127.0.0.1", 0, ready.put, self._stop.is_set)
        self._thread = threading.Thread(target=run_dashboard, args=arguments)
        self._thread.start()
        self.url = ready.get(timeout=WAIT_S)

    def stop(self) -> None:
        self._stop.set()
        self._thread.join()


@pytest.fixture
def stoppable(team: FakeTeam) -> Iterator[Stoppable]:
    with member_at(team.address) as endpoint:
        dashboard = Stoppable(endpoint)
        yield dashboard
        dashboard.stop()


def test_team_is_seen_and_halted_in_a_browser(browser: Browser, team: FakeTeam, stoppable: Stoppable) -> None:
    with window(browser, width=1100, height=740) as context:
        page, errors = open_page(context, stoppable.url)
        title = page.title()
        assert title == "robrain"
        _check_figures(page)

        # The picture is of something, and it moves.
        before = wait_for(lambda: picture_of(page), lambda picture: colors_in(picture) > 20, "a picture")
        wait_for(lambda: picture_of(page), lambda picture: bool((picture != before).any()), "another picture")

        # One click halts; resuming is asked about.
        page.get_by_role("button", name="EMERGENCY HALT", exact=True).click()
        assert next_halt(team).halted
        expect(page.get_by_test_id("halt-state")).to_contain_text("EMERGENCY HALT by operator:dashboard")
        expect(page.get_by_test_id("not-stopped")).to_have_text("r1, r2")
        keep(page, "dashboard-halt")
        page.get_by_role("button", name="Resume after halt …", exact=True).click()
        page.get_by_role("button", name="Keep them halted", exact=True).click()
        page.get_by_role("button", name="Resume after halt …", exact=True).click()
        assert not len(team.heard)
        page.get_by_role("button", name="Resume all robots", exact=True).click()
        resumed = next_halt(team)
        assert (resumed.halted, resumed.by) == (False, "operator:dashboard")
        expect(page.get_by_test_id("halt-state")).to_have_count(0)
        page.keyboard.press("h")
        assert next_halt(team).halted

        # Every layer can be hidden and shown, the camera moved, the colours changed, while all this goes on.
        page.get_by_role("tab", name="View", exact=True).click()
        page.get_by_role("button", name="Top view", exact=True).click()
        for box in page.get_by_role("checkbox").all():
            box.dispatch_event("click")
            box.dispatch_event("click")
        page.keyboard.press("l")
        expect(page.locator("html")).to_have_attribute("data-mantine-color-scheme", "light")
        _check_that_words_stay_words(page, title)
        assert errors == []


def test_two_browsers_have_selections_of_their_own_one_halt_and_see_the_dashboard_go(
    browser: Browser, team: FakeTeam, stoppable: Stoppable
) -> None:
    url = stoppable.url
    with window(browser, width=1000, height=700) as context:
        (first, first_errors), (second, second_errors) = open_page(context, url), open_page(context, url)
        for page, robot in ((first, "r1"), (second, "r2")):
            page.bring_to_front()
            click_on(page, f"[data-rb='select {robot}']")
            page.get_by_role("tab", name="Robot", exact=True).click()
            expect(page.get_by_test_id("selected-robot")).to_have_text(robot)
        first.bring_to_front()
        expect(first.get_by_test_id("selected-robot")).to_have_text("r1")
        first.keyboard.press("n")
        expect(first.get_by_test_id("selected-robot")).to_have_text("r2")
        first.bring_to_front()
        first.keyboard.press("h")
        assert next_halt(team).halted
        for page in (first, second):
            page.bring_to_front()
            expect(page.get_by_test_id("halt-state")).to_be_visible()
        assert first_errors == second_errors == []
        expect(second.locator("#rb-lost")).to_be_hidden()
        stoppable.stop()
        expect(second.locator("#rb-lost")).to_be_visible()


def _check_figures(page: Page) -> None:
    """The panel tells what is on the wire, and goes on doing so."""
    expect(page.get_by_test_id("coordinator")).to_have_text("up")
    expect(page.get_by_test_id("robot-r1-contact")).to_have_text("● up")
    expect(page.get_by_test_id("known-area")).to_have_text("30 m²")
    for moving in ("explored", "sim-time"):
        value = page.get_by_test_id(moving).inner_text()
        expect(page.get_by_test_id(moving)).not_to_have_text(value)
    expect(page.get_by_test_id("speed")).to_have_text(re.compile(r"× (1\.[0-9]|2\.0)"))  # 2.0 on an idle machine


def _check_that_words_stay_words(page: Page, title: str) -> None:
    """What robots and motes say is text wherever it stands."""
    page.get_by_role("tab", name="Team", exact=True).click()
    assert page.get_by_test_id("robot-r1-behavior").inner_text().startswith("<script>")
    page.get_by_text("Log", exact=True).click()
    expect(page.get_by_test_id("log")).to_contain_text("<img src=x onerror")
    page.get_by_role("tab", name="Robot", exact=True).click()
    page.get_by_text("Events", exact=True).click()
    expect(page.get_by_test_id("events")).to_contain_text("<img src=x onerror")
    page.get_by_role("tab", name="View", exact=True).click()
    page.get_by_text("Motes", exact=True).last.click()
    expect(page.get_by_test_id("motes")).to_contain_text("<script>")
    assert page.title() == title
    # Were something to slip through as markup: it would still be no program.
    page.evaluate("document.body.insertAdjacentHTML('beforeend', \"<img src=x onerror='document.title=1'>\")")
    page.wait_for_timeout(200)
    assert page.title() == title


def next_halt(team: FakeTeam) -> Halt:
    end_s = time.monotonic() + WAIT_S
    while not len(team.heard):
        assert time.monotonic() < end_s, "no halt on the wire"
        time.sleep(0.01)
    (received,) = team.heard.drain()
    message: Halt = received.message
    return message


ON_TOP = """() => {
  const box = document.querySelector("#rb-halt").getBoundingClientRect();
  return [[0.5, 0.5], [0.02, 0.1], [0.98, 0.9]].every(([x, y]) =>
    document.elementFromPoint(box.x + x * box.width, box.y + y * box.height)?.id === "rb-halt");
}"""
ADD_WHY = """() => document.body.insertAdjacentHTML("beforeend",
  `<div class="rb" style="position: fixed; top: 200px; left: 200px; z-index: 50">
    <b data-rb="why visit-1">why</b></div>`)"""


@pytest.fixture(scope="module")
def stepped(everybody: FakeTeam) -> Iterator[Stepped]:
    with member_at(everybody.address) as endpoint:
        stepped = Stepped(endpoint)
        yield stepped
        stepped.stop()


@pytest.fixture(scope="module")
def page(browser: Browser, stepped: Stepped) -> Iterator[Page]:
    """On a narrow screen, where least is beside the windows."""
    with window(browser, width=390) as context:
        page, errors = open_page(context, stepped.dashboard.url)
        yield page
        assert errors == []


def test_halt_lies_above_every_window_and_the_palette_its_key_works_there_and_escape_closes_them(
    page: Page, team: FakeTeam
) -> None:
    halt = page.get_by_role("button", name="EMERGENCY HALT", exact=True)
    modal = page.locator(".mantine-Modal-content")
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    halt.click()
    assert next_halt(team).halted
    expect(page.get_by_test_id("halt-missing")).to_have_text("Not stopped: r1, r2")
    _open_why(page)
    for window_name in ("why", "resume"):
        if window_name == "resume":
            _open_resume(page)
        expect(modal).to_be_visible()
        keep(page, f"dashboard-halt-over-{window_name}")
        assert page.evaluate(ON_TOP)
        halt.click()
        assert next_halt(team).halted
        expect(modal).to_be_visible()
        page.keyboard.press("h")
        assert next_halt(team).halted
        page.keyboard.press("Escape")
        expect(modal).to_have_count(0)
    assert not len(team.heard)  # Escape confirms nothing
    _open_resume(page)
    page.get_by_role("button", name="Resume all robots", exact=True).click()
    assert not next_halt(team).halted
    palette = page.locator(".mantine-Spotlight-content")
    page.keyboard.press("Control+k")
    expect(palette).to_be_visible()
    page.get_by_placeholder("Search commands...").press_sequentially("h")  # typing there does not halt
    assert page.evaluate(ON_TOP)
    page.keyboard.press("Escape")
    page.keyboard.press("h")  # works at once
    assert next_halt(team).halted
    expect(palette).to_have_count(0)
    page.keyboard.press("h")
    assert next_halt(team).halted


def test_typing_does_not_halt_and_escape_leaves_the_field(page: Page, team: FakeTeam) -> None:
    page.get_by_role("tab", name="Robot", exact=True).click()
    field = page.get_by_text("Name or path", exact=True).locator("xpath=ancestor::div[.//input][1]//input")
    field.click()
    page.keyboard.type("hello")
    expect(field).to_have_value("hello")
    assert not len(team.heard)
    page.keyboard.press("Escape")
    page.keyboard.press("h")
    assert next_halt(team).halted
    expect(field).to_have_value("hello")
    # A ticked box, a chosen tab and a pressed button have the focus, but nobody types there.
    page.get_by_role("tab", name="View", exact=True).click()
    page.keyboard.press("h")
    assert next_halt(team).halted
    page.get_by_role("checkbox").first.dispatch_event("focus")
    page.keyboard.press("Shift+H")
    assert next_halt(team).halted


def _open_why(page: Page) -> None:
    page.evaluate(ADD_WHY)
    click_on(page, "[data-rb='why visit-1']")
    expect(page.locator(".mantine-Modal-content")).to_be_visible()


def _open_resume(page: Page) -> None:
    button = page.get_by_role("button", name="Resume after halt …", exact=True)
    if button.is_visible():
        button.click()
    else:
        click_on(page, "[data-rb='resume']")
    expect(page.get_by_role("button", name="Resume all robots", exact=True)).to_be_visible()
