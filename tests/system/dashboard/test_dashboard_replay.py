"""The dashboard on a recording: the same page, with a time that can be moved, and what if from there."""

import os
import pty
import re
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from robrain import Scenario
from robrain.recording.reader.reading import recording_info
from tests.system.browser import keep, open_page, picture_of, wait_for, window
from tests.system.conftest import Commands
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.system
DEMO = "from robrain import cli; cli.DEMO = 'arena_small'; cli.main()"
"""`robrain demo`, of a scenario that takes seconds."""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "run.mcap"
    Scenario.builtin("depot").replace(robots=2, seed=7).run(time_limit_s=20.0, record=path)
    return path


def replay(commands: Commands, recording: Path, *options: str) -> str:
    """The page of a replay."""
    process = commands.start("replay", str(recording), "--port", "0", *options)
    return commands.line_with(process, "dashboard: ").split()[1]


def test_recording_is_scrubbed_stepped_and_played(browser: Browser, commands: Commands, recording: Path) -> None:
    with window(browser) as context:
        page, errors = open_page(context, replay(commands, recording, "--start", "0"))
        expect(page.get_by_role("button", name="EMERGENCY HALT")).to_have_count(0)
        # A replay is paused at its start.
        play = page.get_by_role("button", name="▶ Play", exact=True)
        expect(play).to_be_visible()
        expect(page.get_by_test_id("replay-time")).to_have_text(re.compile("^❚❚ 0:00 of"))
        play.click()
        pause = page.get_by_role("button", name="❚❚ Pause", exact=True)
        expect(pause).to_be_visible()
        wait_for(lambda: _position_s(page), lambda at_s: at_s >= 1, "the replay going on")
        pause.click()
        expect(page.get_by_test_id("replay-time")).to_contain_text("❚❚")

        _scrub_to(page, "18")
        late = wait_for(lambda: _explored(page), lambda share: share > 20, "most of the floor")
        picture = picture_of(page)
        _scrub_to(page, "2")
        wait_for(page.get_by_test_id("sim-time").inner_text, lambda text: text in ("0:01", "0:02"), "that time")
        early = wait_for(lambda: _explored(page), lambda share: 0 < share < late - 10, "less of the floor")
        wait_for(lambda: picture_of(page), lambda now: bool((now != picture).any()), "another picture")
        _scrub_to(page, "18")
        wait_for(lambda: _explored(page), lambda share: share > early + 10, "more of the floor")
        _scrub_to(page, "2")
        wait_for(lambda: _explored(page), lambda share: abs(share - early) < 3, "less of the floor again")

        page.get_by_role("button", name="+10 s", exact=True).click()
        wait_for(lambda: _position_s(page), lambda at_s: 11.5 <= at_s <= 12.5, "ten seconds on")
        keep(page, "dashboard-replay")
        page.keyboard.press(" ")
        wait_for(lambda: _position_s(page), lambda at_s: at_s >= 14, "the replay going on")
        expect(page.get_by_test_id("robot-r1-contact")).to_have_text("● up")
        assert errors == []


def test_replay_is_run_again_without_a_robot_from_the_time_shown(
    browser: Browser, commands: Commands, recording: Path
) -> None:
    with window(browser) as context:
        page, errors = open_page(context, replay(commands, recording, "--start", "3"))
        page.get_by_role("tab", name="What if").click()
        page.get_by_label("r2", exact=True).last.check()
        task = page.get_by_text("New task", exact=True).locator("xpath=ancestor::div[.//input][1]//input")
        task.fill("visit --at 14,6.5")
        page.wait_for_timeout(1000)
        page.get_by_role("button", name="What if from here (0:03)", exact=True).click()
        expect(page.get_by_role("button", name="Stop", exact=True)).to_be_visible()
        outcome = page.get_by_test_id("what-if-done")
        expect(outcome).to_be_visible(timeout=1000 * PATIENCE_S)
        expect(outcome).to_contain_text(re.compile(r"before it: equal, \d+ messages"))
        expect(outcome).to_contain_text("visit-1")
        expect(page.get_by_role("button", name="What if from here (0:03)", exact=True)).to_be_visible()
        link = page.get_by_test_id("what-if-link")
        expect(link).to_be_visible(timeout=1000 * PATIENCE_S)
        keep(page, "dashboard-what-if")
        forked = recording.parent / "run.fork-3.02s.mcap"
        assert recording_info(forked).digest
        with urllib.request.urlopen(link.get_attribute("href") or "") as answer:
            assert answer.status == 200

        task.fill("dance")
        page.wait_for_timeout(1000)
        page.get_by_role("button", name="What if from here (0:03)", exact=True).click()
        expect(page.get_by_test_id("what-if-failed")).to_contain_text("dance", timeout=1000 * PATIENCE_S)
        assert errors == []
    assert not (recording.parent / "run.fork-3.02s-2.mcap").exists()


def test_page_of_a_demo_in_a_terminal_shows_its_recording_until_ctrl_c(browser: Browser, commands: Commands) -> None:
    keyboard, terminal = pty.openpty()
    try:
        words = [sys.executable, "-c", DEMO, "demo", "--speed", "1", "--port", "0"]
        pipes = {"stdin": terminal, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
        process = subprocess.Popen(words, cwd=commands.folder, text=True, **pipes)
        commands.adopt(process)
        url = commands.line_with(process, "dashboard: ").split()[1]
        with window(browser) as context:
            page, _ = open_page(context, url)
            expect(page.get_by_role("button", name="EMERGENCY HALT")).to_be_visible()
            assert commands.line_with(process, "now shows the recording").startswith(url)
            expect(page.get_by_role("button", name="▶ Play", exact=True)).to_be_visible(timeout=1000 * PATIENCE_S)
            expect(page.get_by_role("button", name="EMERGENCY HALT")).to_have_count(0)
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 0
    finally:
        os.close(keyboard)
        os.close(terminal)


def _scrub_to(page: Page, time_s: str) -> None:
    """By the number beside the slider, as a drag of it sends the same.

    viser sends what is typed 50 ms later. If the server sets the slider meanwhile, as right after a pause, that
    replaces what was typed; it is typed again then, as a person would.
    """
    field = page.get_by_text("Time (s)", exact=True).locator("xpath=ancestor::div[.//input][1]//input").last
    wanted = f"0:{int(time_s):02} of 0:"

    def is_there() -> bool:
        field.fill(time_s)
        field.press("Enter")
        field.blur()
        try:
            expect(page.get_by_test_id("replay-time")).to_contain_text(wanted, timeout=5000)
        except AssertionError:
            return False
        return True

    until(is_there, f"the replay never came to {wanted}")


def _explored(page: Page) -> float:
    found = re.match(r"([0-9.]+) %", page.get_by_test_id("explored").inner_text())
    return float(found[1]) if found else 0.0


def _position_s(page: Page) -> float:
    found = re.search(r"(\d+):(\d\d) of", page.get_by_test_id("replay-time").inner_text())
    assert found
    return 60 * int(found[1]) + int(found[2])
