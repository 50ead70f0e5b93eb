"""The first start on a computer: the run is seen before its navigation is compiled, and is the same as any other."""

import json
import os
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import psutil
import pytest
from numba.core.caching import _CacheLocator

from robrain.deploy.processes.kernels import _kernels_of, _modules_with_kernels, prepare_kernels
from robrain.deploy.processes.running import PROCESSES
from robrain.recording.drawing.palette import FREE, style_of
from tests.system.browser import chromium, keep, picture_of, share_of, wait_for
from tests.system.conftest import Commands
from tests.system.hanging import stopped
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.system

RUN = ("run", "arena_small", "--time-limit", "2", "--seed", "3")
MISSING = "obstacles."
"""The module whose kernels are not cached; a run needs them at its start."""
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


def compiling_below(pid: int) -> list[int]:
    """The processes that a process has started to compile."""
    found = []
    for child in psutil.Process(pid).children():
        with suppress(psutil.NoSuchProcess):  # it has ended meanwhile
            found += [child.pid for word in child.cmdline() if "compile_worker" in word]
    return found


def fill(cache: Path) -> None:
    """Copy the cached kernels, but for those that are to be missing: to compile all takes minutes."""
    prepare_kernels(quiet=True)
    kernels = [kernel for module in _modules_with_kernels() for kernel in _kernels_of(module)]
    folders = {kernel.__dict__["_cache"].cache_path: kernel.py_func.__code__.co_filename for kernel in kernels}
    for folder, source in folders.items():
        to = cache / _CacheLocator.get_suitable_cache_subpath(source)
        to.mkdir()
        for file in Path(folder).glob("*.nb?"):
            if not file.name.startswith(MISSING):
                shutil.copy2(file, to)


def test_page_shows_floor_and_robots_before_the_kernels_are_compiled_and_the_digest_is_that_of_a_warm_start(
    tmp_path: Path, commands: Commands
) -> None:
    port = _free_port()
    fill(tmp_path)
    with robrain(*RUN, "--json", "--dashboard", "--port", str(port), cache=tmp_path) as process, chromium() as context:
        until(lambda: len(compiling_below(process.pid)) == min(PROCESSES, os.cpu_count() or 1))
        with stopped(compiling_below(process.pid)):  # until the page is seen, whichever is faster
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
            assert not list(tmp_path.rglob(f"{MISSING}*.nbc"))
        told, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    assert list(tmp_path.rglob(f"{MISSING}*.nbc"))
    cold = json.loads(told)
    assert cold["outside_messages"] == 0
    warm = commands.run_here(*RUN, "--json")
    assert warm.returncode == 0, warm.stderr
    assert cold["digest"] == json.loads(warm.stdout)["digest"]


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _is_served(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def _is_seen(picture: np.ndarray) -> bool:
    robots = [share_of(picture, style_of(index).color, within=40) > ROBOT_SHARE for index in range(ROBOTS)]
    return share_of(picture, FREE) > FLOOR_SHARE and any(robots)


def test_run_that_is_killed_while_it_compiles_leaves_no_process_and_no_broken_cache(tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    with robrain(*RUN, cache=cache) as process:
        compiling = until(lambda: list(cache.rglob("*.nbc")) and compiling_below(process.pid))
        process.kill()
        process.wait(PATIENCE_S)
    until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in compiling))
    assert not list(cache.rglob("*.tmp.*"))
