"""The page of a replay: what if from here."""

import re

import pytest
from playwright.sync_api import expect

from robrain.coordinator.recording.reader.reading import recording_info
from tests.system.browser import chromium, keep, open_page
from tests.waiting import PATIENCE_S

pytestmark = pytest.mark.system


def test_replay_is_run_again_without_a_robot_from_the_time_shown(commands) -> None:
    words = ("run", "arena_small", "--seed", "3", "--time-limit", "8", "--until", "explored=1", "--record", "run.mcap")
    done = commands.run_here(*words)
    assert done.returncode == 0, done.stderr
    process = commands.start("replay", "run.mcap", "--port", "0", "--start", "3")
    url = commands.line_with(process, "dashboard: ").split()[1]
    with chromium() as context:
        page, errors = open_page(context, url)
        page.get_by_role("tab", name="What if").click()
        page.get_by_label("r2", exact=True).last.check()
        task = page.get_by_text("New task", exact=True).locator("xpath=ancestor::div[.//input][1]//input")
        task.fill("visit --at 2,2")
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
        forked = commands.folder / "run.fork-3.02s.mcap"
        assert recording_info(forked).digest
        fork_page, fork_errors = open_page(context, link.get_attribute("href") or "")
        expect(fork_page.get_by_test_id("replay-time")).to_be_visible()
        fork_page.close()

        task.fill("dance")
        page.wait_for_timeout(1000)
        page.get_by_role("button", name="What if from here (0:03)", exact=True).click()
        expect(page.get_by_test_id("what-if-failed")).to_contain_text("dance", timeout=1000 * PATIENCE_S)
        assert errors == fork_errors == []
    assert not (commands.folder / "run.fork-3.02s-2.mcap").exists()
