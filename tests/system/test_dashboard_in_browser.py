"""The dashboard as a person sees it: a real server, a real wire, a real Chromium."""

import io
import math
import os
import re
import threading
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from queue import Queue

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Page, expect, sync_playwright

from robrain.coordinator.dashboard import run_dashboard
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.wire.clock import WallClock
from robrain.protocol.wire.endpoint import Drive, Endpoint, Request
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.messages import ArenaTruth, BatteryState, Halt, MapPatch, PlannedPath, RobotState
from robrain.protocol.wire.session import listening_at, open_session
from robrain.protocol.wire.topics import (
    ARENA_TRUTH,
    COORDINATOR_ALIVE,
    HALT,
    ROBOT_ALIVE,
    ROBOT_MAP_WHOLE,
    ROBOT_PATH,
    ROBOT_STATE,
)

pytestmark = pytest.mark.system

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
ROBOTS = ("r1", "r2")
EVIL = "<script>document.title='run'</script><img src=x onerror=\"document.title='run'\">"
WAIT_S = 15.0


class FakeTeam:
    """Two robots that circle in a room which they have mapped before anybody looked on."""

    def __init__(self) -> None:
        self.session = open_session(mode="router", listen=("tcp/127.0.0.1:0",))
        self.heard = Inbox()
        self._endpoint = Endpoint(self.session, "default", WallClock(), Drive.LIVE)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="fake-team")

    @property
    def address(self) -> str:
        return listening_at(self.session)[0]

    def __enter__(self) -> "FakeTeam":
        self._endpoint.subscribe(self.heard, HALT)
        self._endpoint.token(COORDINATOR_ALIVE)
        for robot in ROBOTS:
            self._endpoint.answer(ROBOT_MAP_WHOLE, whole_map, robot=robot)
            self._endpoint.token(ROBOT_ALIVE, robot=robot)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._endpoint.close()
        self.session.close()  # type: ignore[no-untyped-call]

    def _run(self) -> None:
        states = {robot: self._endpoint.publisher(ROBOT_STATE, robot=robot) for robot in ROBOTS}
        paths = {robot: self._endpoint.publisher(ROBOT_PATH, robot=robot) for robot in ROBOTS}
        truth = self._endpoint.publisher(ARENA_TRUTH)
        tick = 0
        while not self._stop.wait(0.1):
            tick += 1
            for number, robot in enumerate(ROBOTS):
                angle_rad = 0.1 * tick + math.pi * number
                pose = Pose2D(2.5 * math.cos(angle_rad), 1.5 * math.sin(angle_rad), angle_rad + math.pi / 2)
                battery = BatteryState(
                    voltage_v=24.0, current_a=1.0, temperature_c=30.0, soc=1 - tick / 1000, remaining_j=1e5
                )
                state = RobotState(robot=robot, pose=pose, radius_m=0.2, battery=battery, behavior=EVIL)
                states[robot].put(state)
                paths[robot].put(PlannedPath(robot=robot, points=[Point2D(pose.x_m, pose.y_m), Point2D(0.0, 0.0)]))
            truth.put(ArenaTruth(sim_time_s=0.2 * tick, robots=[], explored_fraction=min(1.0, tick / 300)))


def whole_map(_: Request) -> MapPatch:
    cells = np.zeros((50, 80), np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = 100
    cells[:, 60:] = -1
    return MapPatch(
        robot="r1",
        resolution_m=0.1,
        origin_x_m=-4.0,
        origin_y_m=-2.5,
        width=80,
        height=50,
        row=0,
        column=0,
        rows=50,
        columns=80,
        observed_ms=0,
        cells=zlib.compress(cells.tobytes()),
    )


@pytest.fixture
def team() -> Iterator[FakeTeam]:
    with FakeTeam() as team:
        yield team


@pytest.fixture
def url(team: FakeTeam) -> Iterator[str]:
    """A dashboard of its own session, as `robrain dashboard` runs it."""
    session = open_session(mode="client", connect=(team.address,))
    endpoint = Endpoint(session, "default", WallClock(), Drive.LIVE)
    ready: Queue[str] = Queue()
    stop = threading.Event()
    thread = threading.Thread(target=run_dashboard, args=(endpoint, "127.0.0.1", 0, ready.put, stop.is_set))
    thread.start()
    yield ready.get(timeout=WAIT_S)
    stop.set()
    thread.join()
    endpoint.close()
    session.close()  # type: ignore[no-untyped-call]


@pytest.fixture
def page(url: str) -> Iterator[Page]:
    if not CHROMIUM.exists():
        missing = f"the dashboard was not looked at: there is no {CHROMIUM} (apt install chromium)"
        if os.environ.get("CI"):
            pytest.fail(missing)
        pytest.skip(missing)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.set_default_timeout(1000 * WAIT_S)
        page.goto(f"{url}?fixedDpr=0.5")
        yield page
        browser.close()


def test_team_is_seen_and_halted_in_a_browser(team: FakeTeam, page: Page) -> None:
    expect.set_options(timeout=1000 * WAIT_S)
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    title = page.title()

    # The panel tells what is on the wire, and goes on doing so.
    expect(page.get_by_test_id("coordinator")).to_have_text("up")
    expect(page.get_by_test_id("robot-r1-contact")).to_have_text("up")
    expect(page.get_by_test_id("known-area")).to_have_text("30 m²")
    for moving in ("robot-r1-place", "robot-r2-place", "explored", "sim-time"):
        value = page.get_by_test_id(moving).inner_text()
        expect(page.get_by_test_id(moving)).not_to_have_text(value)
    expect(page.get_by_test_id("speed")).to_have_text(re.compile(r"× (1\.[0-9]|2\.0)"))  # 2.0 on an idle machine

    # The picture is of something, and it moves.
    before = wait_for(lambda: picture_of(page), lambda picture: colors_in(picture) > 20)
    wait_for(lambda: picture_of(page), lambda picture: bool((picture != before).any()))

    # What a robot says is text.
    assert page.get_by_test_id("robot-r1-behavior").inner_text().startswith("<script>")
    assert page.title() == title

    # One click halts; resuming is asked about.
    page.get_by_role("button", name="EMERGENCY HALT", exact=True).click()
    assert next_halt(team).halted
    expect(page.get_by_test_id("halt-state")).to_contain_text("EMERGENCY HALT by operator:dashboard")
    ARTIFACTS.mkdir(exist_ok=True)
    page.screenshot(path=ARTIFACTS / "dashboard.png")
    page.get_by_role("button", name="Resume after halt …", exact=True).click()
    page.get_by_role("button", name="Keep them halted", exact=True).click()
    page.get_by_role("button", name="Resume after halt …", exact=True).click()
    assert not len(team.heard)
    page.get_by_role("button", name="Resume all robots", exact=True).click()
    resumed = next_halt(team)
    assert (resumed.halted, resumed.by) == (False, "operator:dashboard")
    expect(page.get_by_test_id("halt-state")).to_have_count(0)

    # Every layer can be hidden and shown, and the camera moved, while all this goes on.
    page.get_by_role("button", name="Top view", exact=True).click()
    page.get_by_text("Layers", exact=True).click()
    for box in page.get_by_role("checkbox").all():
        box.click()
        box.click()
    expect(page.get_by_test_id("robot-r1-contact")).to_have_text("up")
    assert errors == []
    assert page.title() == title


def picture_of(page: Page) -> np.ndarray:
    """The scene without panels and notices, uint8 (H, W, 3)."""
    shot = page.screenshot(clip={"x": 330, "y": 160, "width": 480, "height": 400})
    return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB"))


def colors_in(picture: np.ndarray) -> int:
    return len(np.unique(picture.reshape(-1, 3), axis=0))


def wait_for(read: Callable[[], np.ndarray], is_good: Callable[[np.ndarray], bool]) -> np.ndarray:
    end_s = time.monotonic() + WAIT_S
    while not is_good(value := read()):
        assert time.monotonic() < end_s, "the picture did not change"
    return value


def next_halt(team: FakeTeam) -> Halt:
    end_s = time.monotonic() + WAIT_S
    while not len(team.heard):
        assert time.monotonic() < end_s, "no halt on the wire"
        time.sleep(0.01)
    (received,) = team.heard.drain()
    message: Halt = received.message
    return message
