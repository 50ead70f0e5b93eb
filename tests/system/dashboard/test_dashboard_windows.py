"""The halt while windows, palette and fields are open, stacking order, motes when zoomed in; in a real Chromium."""

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.system.browser import click_on, keep, open_page, window
from tests.system.conftest import member_at
from tests.system.dashboard.test_dashboard_in_browser import next_halt
from tests.system.fake_team import FakeTeam
from tests.system.stepped_dashboard import Stepped

pytestmark = pytest.mark.system

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


@pytest.fixture(scope="module", params=[(1280, 800), (390, 800)], ids=["wide", "narrow"])
def page(request: pytest.FixtureRequest, browser: Browser, stepped: Stepped) -> Iterator[Page]:
    with window(browser, *request.param) as context:
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
        keep(page, f"dashboard-halt-over-{window_name}-{page.viewport_size['width']}")  # type: ignore[index]
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


@pytest.mark.parametrize("page", [(1280, 800)], ids=["wide"], indirect=True)
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
