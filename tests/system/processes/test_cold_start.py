"""The first start on a computer: the run is seen before its navigation is compiled, and is the same as any other."""

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from robrain.coordinator.drawing.palette import FREE, look_of
from tests.system.browser import chromium, keep, picture_of, share_of, wait_for
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.system

RUN = ("run", "arena_small", "--time-limit", "2", "--seed", "3")
COMPILING_S = 600.0  # all kernels, on two cores that other tests share
FLOOR_SHARE, ROBOT_SHARE = 0.03, 2.5e-5
ROBOTS = 2


@contextmanager
def robrain(*words: str, cache: Path) -> Iterator[subprocess.Popen[str]]:
    """A command whose kernels are cached in a folder; killed at the end if it still runs."""
    process = subprocess.Popen(
        [sys.executable, "-m", "robrain.cli", *words],
        env={**os.environ, "NUMBA_CACHE_DIR": str(cache)},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def digest_of(cache: Path) -> str:
    with robrain(*RUN, "--json", cache=cache) as process:
        told, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    return str(json.loads(told)["digest"])


def compiling_below(pid: int) -> list[int]:
    """The processes that a process has started to compile."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
                words = (entry / "cmdline").read_text()
            except OSError:
                continue
            if parent == pid and "compile_worker" in words:
                found.append(int(entry.name))
    return found


def test_page_shows_floor_and_robots_before_the_kernels_are_compiled_and_the_digest_is_that_of_a_warm_start(
    tmp_path: Path,
) -> None:
    port = _free_port()
    with robrain(*RUN, "--json", "--dashboard", "--port", str(port), cache=tmp_path) as process:
        with chromium() as context:
            page = context.new_page()
            until(lambda: _is_served(port))
            page.goto(f"http://127.0.0.1:{port}?fixedDpr=0.5", wait_until="commit")
            notice = page.get_by_test_id("preparation")
            wait_for(
                lambda: notice.count() == 1 and _is_seen(picture_of(page)), bool, "a picture before the run begins"
            )
            keep(page, "preparing")
            assert "of the navigation" in notice.inner_text()
            assert page.get_by_test_id("team").inner_text() == f"{ROBOTS} of {ROBOTS} robots ready"
            assert compiling_below(process.pid)
        told, _ = process.communicate(timeout=COMPILING_S)
        assert process.returncode == 0
    cold = json.loads(told)
    assert cold["outside_messages"] == 0
    assert cold["digest"] == digest_of(tmp_path)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _is_served(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def _is_seen(picture: np.ndarray) -> bool:
    robots = [share_of(picture, look_of(index).color, within=40) > ROBOT_SHARE for index in range(ROBOTS)]
    return share_of(picture, FREE) > FLOOR_SHARE and any(robots)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_run_that_ends_while_it_compiles_leaves_no_process_and_no_broken_cache(tmp_path: Path, number: int) -> None:
    cache = tmp_path / "cache"
    with robrain(*RUN, cache=cache) as process:
        compiling = until(lambda: list(cache.rglob("*.nbc")) and compiling_below(process.pid))
        process.send_signal(number)
        process.wait(PATIENCE_S)
        assert process.returncode == (-signal.SIGKILL if number == signal.SIGKILL else 130)
    until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in compiling))
    assert not list(cache.rglob("*.tmp.*"))
