"""The pages that are made of a recording, in a real Chromium: nothing in one runs, and nothing is fetched."""

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, BrowserContext, Page

from robrain.dashboard.replay.html_player import write_html
from robrain.recording.drawing.palette import FREE, UNKNOWN
from tests.lab.report.test_report import hostile_said, write
from tests.system.browser import colors_in, keep, share_of, wait_for, window

pytestmark = pytest.mark.system


def camera_target(context: BrowserContext, path: Path) -> tuple[Page, list[str], list[str]]:
    """A page, what went wrong or popped up on it, and what it fetched beside itself."""
    page = context.new_page()
    wrong: list[str] = []
    fetched: list[str] = []
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("dialog", lambda dialog: (wrong.append(f"dialog: {dialog.message}"), dialog.dismiss()))
    page.on("request", lambda request: fetched.append(request.url))
    page.goto(f"{path.as_uri()}?fixedDpr=0.5")
    return page, wrong, fetched


def scene_of(page: Page) -> np.ndarray:
    """The picture between the notice above and the player's bar below, uint8 (H, W, 3)."""
    shot = page.screenshot(clip={"x": 0, "y": 180, "width": 1280, "height": 540})
    return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB"))


def share_of_map(picture: np.ndarray) -> float:
    return share_of(picture, UNKNOWN) + share_of(picture, FREE)


def beside(path: Path, fetched: list[str]) -> list[str]:
    return [url for url in fetched if not url.startswith(("data:", "blob:", path.as_uri()))]


def test_a_page_plays_a_run_by_itself(tmp_path: Path, depot_run: Path, browser: Browser) -> None:
    path = tmp_path / "run.html"
    write_html(depot_run, path)
    with window(browser) as context:
        page, wrong, fetched = camera_target(context, path)
        before = wait_for(lambda: scene_of(page), lambda picture: colors_in(picture) > 20, "a picture")
        wait_for(lambda: scene_of(page), lambda picture: bool(np.any(picture != before)), "another picture")
        wait_for(lambda: share_of_map(scene_of(page)[:, 320:960]), lambda share: share > 0.3, "the map in the middle")
        keep(page, "recording_as_a_page")
        assert wrong == []
        assert beside(path, fetched) == []


def test_a_hostile_recording_does_nothing_in_the_page_that_plays_it(tmp_path: Path, browser: Browser) -> None:
    path = tmp_path / "run.html"
    write_html(write(tmp_path / "run.mcap", hostile_said()), path, frames_max=100)
    with window(browser) as context:
        page, wrong, fetched = camera_target(context, path)
        wait_for(lambda: scene_of(page), lambda picture: colors_in(picture) > 3, "a picture")
        page.wait_for_timeout(1000)
        assert wrong == []
        assert beside(path, fetched) == []
