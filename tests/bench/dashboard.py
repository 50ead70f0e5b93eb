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
from typing import NamedTuple

from playwright.sync_api import Browser, Page, sync_playwright
from rich.console import Console
from rich.table import Table

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


class Figure(NamedTuple):
    """One line of the table."""

    what: str
    value: str
    beside: str
    bound: str
    is_kept: bool


def measure() -> Iterator[Figure]:
    """The figures; none where there is no Chromium."""
    if not CHROMIUM.exists():
        return
    with _running("-m", "tests.bench.dashboard_team") as team:
        hub = _line(team)
        with _running("-m", "robrain.cli", "dashboard", "--connect", hub, "--port", "0") as dashboard:
            url = _line(dashboard).split()[-1]
            time.sleep(SETTLE_S)
            unwatched = _share(dashboard.pid)
            yield Figure("dashboard process, nobody looks on", f"{100 * unwatched:.0f} % of a core", "", "", True)
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
    yield Figure("first useful picture", f"{took_s:.1f} s", beside, f"≤ {FIRST_S:g} s", took_s <= FIRST_S)
    time.sleep(SETTLE_S)
    before = sum(map(_ticks, browser_processes()))
    frames_hz = float(first.evaluate(COUNT_FRAMES, WINDOW_S))
    used_s = (sum(map(_ticks, browser_processes())) - before) / os.sysconf("SC_CLK_TCK")
    yield Figure("frames a second", f"{frames_hz:.0f}", _load(), f"≥ {FRAMES_HZ:g}", frames_hz >= FRAMES_HZ)
    each_ms = 1000 * used_s / max(1.0, frames_hz * WINDOW_S)
    yield Figure("CPU of the browser for a frame", f"{each_ms:.0f} ms", f"{used_s / WINDOW_S:.2f} cores", "", True)
    yield Figure("dashboard process, one browser", f"{100 * _share(dashboard):.0f} % of a core", "", "", True)
    _open(browser, url)
    time.sleep(SETTLE_S)
    share = _share(dashboard)
    beside = f"the team itself: {100 * _share(team):.0f} %"
    bound = f"≤ {100 * CORE_SHARE:.0f} %"
    yield Figure(
        "dashboard process, two browsers", f"{100 * share:.0f} % of a core", beside, bound, share <= CORE_SHARE
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


def main() -> None:
    """Print the table."""
    table = Table(title=f"The dashboard with {ROBOTS} robots and {MOTES} motes, browsers in software rendering")
    for heading in ("what", "measured", "beside", "bound", "kept"):
        table.add_column(heading)
    for figure in measure():
        kept = "" if not figure.bound else "yes" if figure.is_kept else "no"
        table.add_row(figure.what, figure.value, figure.beside, figure.bound, kept)
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
