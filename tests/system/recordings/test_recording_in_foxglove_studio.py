"""A recording, opened in Foxglove Studio itself: every channel is read, and the run is drawn.

It is the last version that was published as open source, from npm, of which Lichtblick is the continuation.
"""

import io
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import quote

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Page

from robrain.recording.drawing.palette import FREE, ROBOT_COLORS
from robrain.recording.reader.reading import recording_info
from tests.system.browser import chromium, keep, share_of, wait_for
from tests.system.npm_packages import installed
from tests.waiting import until

pytestmark = pytest.mark.system

PACKAGES = ("@foxglove/studio-base@1.48.0", "react@17.0.2", "react-dom@17.0.2")
PAGE = Path(__file__).with_name("foxglove_studio.html")
ASSETS = "node_modules/@foxglove/studio-base/assets"
DRAWN = ("map", "walls", "robots", "motes", "tasks", "r1/path", "r1/trail", "r1/points", "r1/pose", "r1/scan")
PLOTTED = ("/visual/r1/battery.soc", "robrain/default/robot/r1/state.battery.soc")
WIDTH, HEIGHT = 1400, 900
SCENE = {"x": 400, "y": 60, "width": 540, "height": 700}
SEEK = (900, HEIGHT - 56)
"""On the bar below, behind the middle of the run."""


@contextmanager
def served(packages: Path, recording: Path) -> Iterator[str]:
    """Studio's files and the recording on loopback, in ranges, as Studio asks for them."""

    class Files(SimpleHTTPRequestHandler):
        def do_GET(self) -> None:
            name = self.path.partition("?")[0]
            places = {"/": PAGE, f"/{recording.name}": recording}
            path = places.get(name, packages / name[1:])
            if not path.is_file():  # a worker of Studio's looks for the rest of it at the root
                path = packages / ASSETS / name[1:]
            if not path.is_file():
                self.send_error(404)
                return
            data = path.read_bytes()
            asked = re.fullmatch(r"bytes=(\d+)-(\d*)", self.headers.get("Range", ""))
            first, last = (int(asked[1]), int(asked[2] or len(data) - 1)) if asked else (0, len(data) - 1)
            self.send_response(206 if asked else 200)
            if asked:
                self.send_header("Content-Range", f"bytes {first}-{last}/{len(data)}")
            self.send_header("Accept-Ranges", "bytes")
            self.send_header("Content-Type", self.guess_type(str(path)))
            self.send_header("Content-Length", str(last - first + 1))
            self.end_headers()
            self.wfile.write(data[first : last + 1])

        def log_message(self, format: str, *arguments: object) -> None:
            """Say nothing."""

        def handle(self) -> None:
            try:
                super().handle()
            except ConnectionError:  # a browser that has read enough hangs up
                self.close_connection = True

    server = ThreadingHTTPServer(("127.0.0.1", 0), Files)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def is_shown(page: Page, row: re.Pattern[str]) -> bool:
    return row.search(page.inner_text("body")) is not None


def scene_of(page: Page) -> np.ndarray:
    """What the panel with the scene shows, uint8 (H, W, 3)."""
    return np.asarray(Image.open(io.BytesIO(page.screenshot(clip=SCENE))).convert("RGB"))


def test_foxglove_studio_reads_every_channel_and_draws_the_run(depot_run: Path) -> None:
    packages = installed("foxglove-studio", PACKAGES)
    counts = recording_info(depot_run).counts
    topics = ",".join(f"/visual/{name}" for name in DRAWN)
    problems: list[str] = []
    with served(packages, depot_run) as address, chromium(WIDTH, HEIGHT) as context:
        page = context.new_page()
        page.on("console", lambda said: problems.append(said.text) if "Player problem" in said.text else None)
        page.on("pageerror", lambda error: problems.append(str(error)))
        asked = f"file=/{depot_run.name}&topics={quote(topics)}&paths={quote(','.join(PLOTTED))}"
        page.goto(f"{address}/?{asked}", wait_until="commit")
        wait_for(lambda: page.inner_text("body"), lambda text: "/visual/walls" in text, "channels")
        assert problems == []
        for key, count in counts.items():
            row = re.compile(rf"{re.escape(key)}\s+\S+\s+{count}\b")
            until(partial(is_shown, page, row), f"{key} is not shown with {count} messages")
        page.mouse.click(*SEEK)
        wait_for(lambda: share_of(scene_of(page), FREE, 40), lambda share: share > 0.05, "the floor")
        wait_for(lambda: share_of(scene_of(page), ROBOT_COLORS[0], 40), lambda share: share > 0, "a robot")
        keep(page, "recording_in_foxglove_studio")
        assert problems == []
