"""How long it takes to set up a run, and from the start of `robrain demo` until its page shows floor and robots.

In a fresh clone of the repository, first without byte code and compiled kernels, then with all of both. The browser is
up and opens the address as soon as the demo prints it. A picture counts when the scene has the colours of free floor
and of robots, by the browser's own screenshot.
"""

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from playwright.sync_api import Browser, Page

from robrain import Scenario
from robrain.lab.bench.figure import Figure, at_most, timing
from robrain.recording.drawing.palette import FREE, style_of
from robrain.sim.lockstep.lockstep import LockstepRun
from tests.bench.processes import wait_for
from tests.bench.real_time_factor import calibration_ns
from tests.bench.results import ROOT
from tests.system.browser import browser_process, picture_of, share_of, window

COLD_S, WARM_S = 8.0, 4.0
MANY, MANY_S = 64, 1.0
"""Robots that are set up, and the bound for it."""
ROBOTS, SEEN_ROBOTS = 4, 2
"""Robots of the demo, and how many must be seen: names cover some, as they start side by side."""
FLOOR_SHARE, ROBOT_SHARE = 0.03, 2.5e-5
"""Of the picture: some hundred pixels of floor, and five of a robot."""
READY = "dashboard: "
REST = "from robrain.deploy.processes.kernels import prepare_kernels; prepare_kernels(quiet=True)"
LIMIT_S = 300.0
STOP_S = 30.0


class Times(NamedTuple):
    """Seconds since the demo was started."""

    address_s: float
    picture_s: float
    moving_s: float


def measure() -> Iterator[Figure]:
    """The figures: the set-up first, then those of a cold and of a warm start."""
    yield timing("calibration: a turn of a loop in plain Python", calibration_ns(), "ns")
    yield timing(f"{MANY} robots: set-up", _set_up_s(), "s", at_most(MANY_S))
    with tempfile.TemporaryDirectory() as folder, browser_process() as browser:
        clone = Path(folder) / "robrain"
        subprocess.run(["git", "clone", "--quiet", "--local", str(ROOT), str(clone)], check=True)
        for words, bound_s in (("cold", COLD_S), ("warm", WARM_S)):
            times = first_picture(browser, clone)
            yield timing(f"{words} start: first picture", times.picture_s, "s", at_most(bound_s))
            yield timing(f"{words} start: address of the page", times.address_s, "s")
            yield timing(f"{words} start: robots move", times.moving_s, "s")
            # The demo was stopped when robots moved, so some kernels are missing that a longer demo would compile.
            subprocess.run([sys.executable, "-c", REST], check=True, cwd=clone)


def _set_up_s() -> float:
    world = Scenario.builtin("depot").replace(robots=MANY).world()
    begun_s = time.perf_counter()
    run = LockstepRun(world)
    took_s = time.perf_counter() - begun_s
    run.close()
    return took_s


def first_picture(browser: Browser, clone: Path) -> Times:
    """Start the demo of a clone, and look at its page until the robots move; then stop it."""
    with window(browser) as context:
        page = context.new_page()
        with demo_of(clone) as (process, begun_s):
            url = address_of(process)
            address_s = time.monotonic() - begun_s
            page.goto(f"{url}?fixedDpr=0.5", wait_until="commit")
            # Screenshots while the page loads would delay it.
            page.get_by_test_id("sim-time").wait_for(timeout=1000.0 * LIMIT_S)
            wait_for(lambda: shows_floor_and_robots(page), "no picture", LIMIT_S, 0.0)
            picture_s = time.monotonic() - begun_s
            wait_for(lambda: moves(page), "no robot moved", LIMIT_S, 0.05)
            return Times(address_s, picture_s, time.monotonic() - begun_s)


@contextmanager
def demo_of(clone: Path) -> Iterator[tuple[subprocess.Popen[str], float]]:
    """`robrain demo` of a clone, and when it was started; interrupted at the end."""
    environment = {**os.environ, "PYTHONPATH": str(clone), "PYTHONUNBUFFERED": "1"}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    begun_s = time.monotonic()
    process = subprocess.Popen(
        [sys.executable, "-m", "robrain.cli", "demo", "--port", "0"],
        cwd=clone,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        yield process, begun_s
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(STOP_S)


def address_of(process: subprocess.Popen[str]) -> str:
    """The page's address, as the demo prints it."""
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith(READY):
            return line.removeprefix(READY).strip()
    raise RuntimeError(f"the demo ended with status {process.wait()} before its page was served")


def shows_floor_and_robots(page: Page) -> bool:
    """Whether the scene has free floor and robots, by their colours."""
    if page.locator("canvas").count() == 0:
        return False
    picture = picture_of(page)
    robots = [share_of(picture, style_of(index).color, within=40) > ROBOT_SHARE for index in range(ROBOTS)]
    return share_of(picture, FREE) > FLOOR_SHARE and sum(robots) >= SEEN_ROBOTS


def moves(page: Page) -> bool:
    """Whether the run has begun."""
    told = page.get_by_test_id("sim-time")
    return told.count() == 1 and told.inner_text() not in ("–", "00:00")
