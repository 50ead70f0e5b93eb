"""Kernels are compiled in processes beside a run, which end with it in every case."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from robrain.deploy.processes import running
from robrain.deploy.processes.kernels import PARTS
from robrain.deploy.processes.running import KernelCompiler
from tests.waiting import has_ended, until

FEW = {"obstacles": PARTS["obstacles"], "map overlap": PARTS["map overlap"]}
SCRIPT = """
import time
from robrain.deploy.processes.running import KernelCompiler
from robrain.deploy.processes.kernels import PARTS
with KernelCompiler(PARTS, 1) as compiler:
    print(compiler._workers[0]._process.pid, flush=True)
    time.sleep(600)
"""


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    return tmp_path


@pytest.mark.slow
def test_parts_at_the_start_are_stored_first_then_one_process_compiles_and_ends_with_the_block(
    empty_cache: Path,
) -> None:
    with KernelCompiler(FEW, 2) as compiler:
        first, second = (worker._process for worker in compiler._workers.values())
        assert compiler.progress == (0, 1, None)
        until(lambda: compiler.is_done and second.poll() is not None, step=compiler.step)
        assert compiler.progress.ready == 1
        assert compiler.failure == ""
        assert second.returncode == 0
        assert first.poll() is None  # it still compiles what is needed later
        assert list(empty_cache.rglob("obstacles*.nbc"))
        begun_s = time.monotonic()
    assert time.monotonic() - begun_s < 2 * running.STOP_S
    assert first.poll() is not None
    assert not list(empty_cache.rglob("*.tmp.*"))


def test_process_that_fails_is_told_and_nobody_waits_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(running, "MODULE", "no_such_module")
    with KernelCompiler(FEW, 1) as compiler:
        until(lambda: compiler.is_done, step=compiler.step)
        assert compiler.failure == "a compiling process ended with status 1"


def test_python_that_cannot_be_started_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(sys, "executable", str(tmp_path / "none"))
    with KernelCompiler(FEW, 1) as compiler:
        assert compiler.is_done
        assert "No such file" in compiler.failure


@pytest.mark.slow
def test_process_ends_when_its_parent_is_killed(empty_cache: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", SCRIPT], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        until(lambda: list(empty_cache.rglob("*.nbc")))
        os.kill(parent.pid, signal.SIGKILL)
    until(lambda: has_ended(pid))
    assert not list(empty_cache.rglob("*.tmp.*"))
