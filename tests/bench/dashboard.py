"""The dashboard with 100 robots and 400 motes: what its process takes, and how soon and how often a browser draws.

Browsers are Chromium in software rendering, which is the slowest that there is; team, dashboard and browsers share this
machine's cores. `python -m tests.bench.dashboard` prints the table.
"""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Browser, Page, sync_playwright
from rich.console import Console

from robrain.lab.bench.figure import WIDTH, Figure, at_least, at_most, show_figures, timing
from tests.bench.dashboard_team import MOTES, ROBOTS
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
    with _running("-m", "tests.bench.dashboard_team") as team:
        hub = _line(team)
        with _running("-m", "robrain.cli", "dashboard", "--connect", hub, "--port", "0") as dashboard:
            url = _line(dashboard).split()[-1]
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
    used_s = sum(map(_ticks, browser_processes())) / os.sysconf("SC_CLK_TCK")
    beside = f"{used_s:.1f} s of CPU, {_load()}"
    yield timing("first useful picture", took_s, "s", at_most(FIRST_S), beside)
    time.sleep(SETTLE_S)
    before = sum(map(_ticks, browser_processes()))
    frames_hz = float(first.evaluate(COUNT_FRAMES, WINDOW_S))
    used_s = (sum(map(_ticks, browser_processes())) - before) / os.sysconf("SC_CLK_TCK")
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
    before, began_s = _ticks(process), time.monotonic()
    time.sleep(WINDOW_S)
    return (_ticks(process) - before) / os.sysconf("SC_CLK_TCK") / (time.monotonic() - began_s)


def _ticks(process: int) -> int:
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return int(fields[11]) + int(fields[12])


def _load() -> str:
    return f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"


@contextmanager
def _running(*words: str) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen([sys.executable, *words], stdout=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.terminate()
        process.wait(20)
        if process.stdout is not None:
            process.stdout.close()


def _line(process: subprocess.Popen[str]) -> str:
    return process.stdout.readline().strip() if process.stdout is not None else ""


if __name__ == "__main__":
    title = f"The dashboard with {ROBOTS} robots and {MOTES} motes, browsers in software rendering"
    show_figures(title, measure(), Console(width=WIDTH))
