"""A real Chromium for tests of the dashboard; one at a time, as it draws in software on the test's own cores."""

import io
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

import numpy as np
import psutil
import pytest
from PIL import Image
from playwright.sync_api import Browser, BrowserContext, Page, expect, sync_playwright

CHROMIUM = Path("/usr/bin/chromium")
ARGUMENTS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--use-angle=swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
ARTIFACTS = Path(__file__).parents[2] / "test-artifacts"
WAIT_S = 100.0
"""Longest wait for a page."""
MIDDLE_OF = """async (selector) => {
  const place = () => {
    const found = document.querySelector(selector);
    if (!found) return null;
    found.scrollIntoView({ block: "nearest" });
    const box = found.getBoundingClientRect();
    return { x: box.x + box.width / 2, y: box.y + box.height / 2 };
  };
  const before = place();
  await new Promise((done) => setTimeout(done, 100));
  const after = place();
  const rests = before && after && before.x === after.x && before.y === after.y;
  return rests && document.elementFromPoint(after.x, after.y)?.closest(selector) ? after : null;
}"""
"""The point to click on an element, once it has stopped moving and nothing covers it, as sections open gradually."""
CALM = """
(() => {
  const PAUSE_MS = 500;
  window.requestAnimationFrame = (draw) => {
    const wait_ms = PAUSE_MS - (performance.now() % PAUSE_MS);
    return setTimeout(() => draw(performance.now()), wait_ms);
  };
  window.cancelAnimationFrame = (number) => clearTimeout(number);
})();
"""
"""Limits pages to two frames a second, as each frame costs much CPU without a graphics card."""
NOTICES = """
(() => {
  const told = (window.toldNotices = new Set());
  new MutationObserver(() => {
    for (const one of document.querySelectorAll(".mantine-Notification-root")) told.add(one.textContent);
  }).observe(document, { childList: true, subtree: true, characterData: true });
})();
"""
"""Keeps what notices say, which close by themselves, maybe before a busy test looks."""
CLOSE_NOTICES = "document.querySelectorAll('.mantine-Notification-closeButton').forEach((one) => one.click())"
T = TypeVar("T")


@contextmanager
def browser_process() -> Iterator[Browser]:
    """A browser, closed at the end; skips the test where there is none, and fails it in CI, which must have one."""
    if not CHROMIUM.exists():
        missing = f"the dashboard was not looked at: there is no {CHROMIUM} (apt install chromium)"
        if os.environ.get("CI"):
            pytest.fail(missing)
        pytest.skip(missing)
    expect.set_options(timeout=1000 * WAIT_S)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(ARGUMENTS))
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def window(browser: Browser, width: int = 1280, height: int = 800) -> Iterator[BrowserContext]:
    """A window of a browser, with its pages closed at the end."""
    context = browser.new_context(viewport={"width": width, "height": height})
    context.set_default_timeout(1000 * WAIT_S)
    context.add_init_script(CALM)
    context.add_init_script(NOTICES)
    try:
        yield context
    finally:
        context.close()


@contextmanager
def chromium(width: int = 1280, height: int = 800) -> Iterator[BrowserContext]:
    """A browser of one window, as `browser_process`."""
    with browser_process() as browser, window(browser, width, height) as context:
        yield context


def open_page(context: BrowserContext, url: str) -> tuple[Page, list[str]]:
    """A page on a dashboard, and the errors and dialogs that it has had so far."""
    page = context.new_page()
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("dialog", lambda dialog: (errors.append(f"dialog: {dialog.message}"), dialog.dismiss()))
    page.goto(f"{url}?fixedDpr=0.5")
    expect(page.get_by_test_id("team")).to_be_visible()
    # viser tells in a corner that there is no graphics card.
    page.locator(".mantine-Notification-closeButton").first.click()
    return page, errors


def click_on(page: Page, selector: str) -> None:
    """Click on something in a table, which may be redrawn at any moment; the mouse does not mind."""
    found = wait_for(lambda: page.evaluate(MIDDLE_OF, selector), bool, selector)
    page.mouse.click(found["x"], found["y"])


def notices(page: Page) -> list[str]:
    """What all notices have said that the page has shown."""
    told: list[str] = page.evaluate("[...window.toldNotices]")
    return told


def keep(page: Page, name: str) -> None:
    """Keep a picture of the page for people to look at."""
    ARTIFACTS.mkdir(exist_ok=True)
    page.screenshot(path=ARTIFACTS / f"{name}.png")


def picture_of(page: Page) -> np.ndarray:
    """The scene without panels and notices, uint8 (H, W, 3)."""
    shot = page.screenshot(clip={"x": 330, "y": 160, "width": 480, "height": 400})
    return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB"))


def colors_in(picture: np.ndarray) -> int:
    """How many colours a picture has."""
    return len(np.unique(picture.reshape(-1, 3), axis=0))


def wait_for(read: Callable[[], T], is_good: Callable[[T], bool], what: str, timeout_s: float = WAIT_S) -> T:
    """Read until it is good."""
    end_s = time.monotonic() + timeout_s
    while not is_good(value := read()):
        assert time.monotonic() < end_s, f"{what} did not come; last: {value!r:.300}"
        time.sleep(0.05)
    return value


def share_of(picture: np.ndarray, color: tuple[int, int, int], within: int = 20) -> float:
    """Which share of a picture is about so coloured, 0 to 1."""
    near = np.abs(picture.astype(int) - color).max(axis=2) <= within
    return float(near.mean())


def browser_processes() -> list[int]:
    """The browser that this test started, with all of its processes, and none but those."""
    found = [child.pid for child in psutil.Process().children(recursive=True) if "chromium" in child.name()]
    assert found
    return found
