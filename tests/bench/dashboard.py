"""The dashboard with 100 robots and 400 motes: what its process takes, and how soon and how often a browser draws.

Browsers are Chromium in software rendering, which is the slowest that there is; team, dashboard and browsers share this
machine's cores.
"""

import os
import subprocess
import time
from collections.abc import Iterator

from playwright.sync_api import Browser, Page, sync_playwright

from robrain.lab.bench.figure import Figure, at_least, at_most, timing
from tests.bench.processes import ROBRAIN, cpu_s, line_of, running
from tests.system.browser import ARGUMENTS, CHROMIUM, browser_processes, colors_in, picture_of

CORE_SHARE, FIRST_S, FRAMES_HZ = 0.40, 5.0, 15.0
WINDOW_S = 8.0
SETTLE_S = 4.0
PATIENCE_S = 60.0
COUNT_FRAMES = """async (seconds) => {
  let frames = 0, running = true;
  const count = () => { frames++; if (running) requestAnimationFrame(count); };
  requestAnimationFrame(count);
  await new Promise((done) => setTimeout(done, 1000 * seconds));
  running = false;
  return frames / seconds;
}"""


def measure() -> Iterator[Figure]:
    """The figures (FileNotFoundError without Chromium)."""
    if not CHROMIUM.exists():
        raise FileNotFoundError(f"{CHROMIUM}: expected Chromium, there is none (make browser)")
    with running("-m", "tests.bench.dashboard_team", stdout=subprocess.PIPE) as team:
        hub = line_of(team)
        with running(*ROBRAIN, "dashboard", "--connect", hub, "--port", "0", stdout=subprocess.PIPE) as dashboard:
            url = line_of(dashboard).split()[-1]
            time.sleep(SETTLE_S)
            unwatched = _share(dashboard.pid)
            yield timing("dashboard process without browsers, share of a core", 100 * unwatched, "%")
            with sync_playwright() as playwright:
                browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(ARGUMENTS))
                try:
                    yield from _with_browsers(browser, url, dashboard.pid, team.pid)
                finally:
                    browser.close()


def _with_browsers(browser: Browser, url: str, dashboard: int, team: int) -> Iterator[Figure]:
    first, took_s = _open(browser, url)
    used_s = sum(map(cpu_s, browser_processes()))
    beside = f"{used_s:.1f} s of CPU, {_load()}"
    yield timing("first useful picture", took_s, "s", at_most(FIRST_S), beside)
    time.sleep(SETTLE_S)
    before_s = sum(map(cpu_s, browser_processes()))
    frames_hz = float(first.evaluate(COUNT_FRAMES, WINDOW_S))
    used_s = sum(map(cpu_s, browser_processes())) - before_s
    yield timing("frames a second", frames_hz, "Hz", at_least(FRAMES_HZ), _load())
    each_ms = 1000 * used_s / max(1.0, frames_hz * WINDOW_S)
    yield timing("CPU of the browser for a frame", each_ms, "ms", beside=f"{used_s / WINDOW_S:.2f} cores")
    yield timing("dashboard process, one browser, share of a core", 100 * _share(dashboard), "%")
    _open(browser, url)
    time.sleep(SETTLE_S)
    share = _share(dashboard)
    beside = f"the team itself: {100 * _share(team):.0f} %"
    yield timing(
        "dashboard process, two browsers, share of a core", 100 * share, "%", at_most(100 * CORE_SHARE), beside
    )


def _open(browser: Browser, url: str) -> tuple[Page, float]:
    """A page, and how long it took until robots and map were to be seen."""
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    page.set_default_timeout(1000 * PATIENCE_S)
    began_s = time.monotonic()
    page.goto(f"{url}?fixedDpr=0.5")
    page.get_by_test_id("robot-r1-contact").wait_for()
    while colors_in(picture_of(page)) < 60:
        if time.monotonic() - began_s > PATIENCE_S:
            break
    return page, time.monotonic() - began_s


def _share(process: int) -> float:
    """Share of a core that a process takes, user and system."""
    before_s, began_s = cpu_s(process), time.monotonic()
    time.sleep(WINDOW_S)
    return (cpu_s(process) - before_s) / (time.monotonic() - began_s)


def _load() -> str:
    return f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
