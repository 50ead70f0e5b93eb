"""Kernels are compiled in processes beside a run, which end with it in every case."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from robrain.deploy.run import preparing
from robrain.deploy.run.kernels import PARTS
from robrain.deploy.run.preparing import KernelCompiler
from robrain.protocol.model.warm_up import Part
from tests.waiting import until

FEW = {"obstacles": PARTS["obstacles"], "map overlap": PARTS["map overlap"]}
SCRIPT = """
import time
from robrain.deploy.run.preparing import KernelCompiler
from robrain.deploy.run.kernels import PARTS
with KernelCompiler(PARTS, 2) as compiler:
    print(*(worker._process.pid for worker in compiler._workers), flush=True)
    time.sleep(600)
"""


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    return tmp_path


@pytest.mark.slow
def test_parts_at_the_start_are_compiled_first_and_stored(empty_cache: Path) -> None:
    with KernelCompiler(FEW, 1) as compiler:
        assert compiler.progress == (0, 1, None)
        until(lambda: compiler.is_done, step=compiler.step)
        assert compiler.progress.ready == 1
        assert compiler.failure == ""
    assert list(empty_cache.rglob("obstacles*.nbc"))
    assert not list(empty_cache.rglob("*.tmp.*"))


@pytest.mark.slow
def test_parts_that_are_needed_later_are_left_to_one_process(empty_cache: Path) -> None:
    later = {name: part for name, part in PARTS.items() if not part.at_start}
    with KernelCompiler(later, 2) as compiler:
        first, second = (worker._process for worker in compiler._workers)
        until(lambda: second.poll() is not None, step=compiler.step)
        assert second.returncode == 0
        assert first.poll() is None
        assert compiler.failure == ""


@pytest.mark.slow
def test_process_that_fails_is_told_and_nobody_waits_for_it(empty_cache: Path) -> None:
    with KernelCompiler({"no such part": Part(PARTS["obstacles"].warm_up, at_start=True)}, 1) as compiler:
        until(lambda: compiler.is_done, step=compiler.step)
        assert compiler.failure == "a compiling process ended with status 1"


def test_python_that_cannot_be_started_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(sys, "executable", str(tmp_path / "none"))
    with KernelCompiler(FEW, 1) as compiler:
        assert compiler.is_done
        assert "No such file" in compiler.failure


@pytest.mark.slow
def test_left_block_ends_the_processes_within_the_limit(empty_cache: Path) -> None:
    compiler = KernelCompiler(PARTS, 1)
    pids = [worker._process.pid for worker in compiler._workers]
    until(lambda: list(empty_cache.rglob("*.nbc")), step=compiler.step)
    begun_s = time.monotonic()
    compiler.close()
    assert time.monotonic() - begun_s < 2 * preparing.STOP_S
    assert not any(_runs(pid) for pid in pids)


@pytest.mark.slow
def test_processes_end_when_their_parent_is_killed(empty_cache: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", SCRIPT], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        pids = [int(word) for word in parent.stdout.readline().split()]
        until(lambda: list(empty_cache.rglob("*.nbc")))
        os.kill(parent.pid, signal.SIGKILL)
    assert len(pids) == 2
    until(lambda: not any(_runs(pid) for pid in pids))
    assert not list(empty_cache.rglob("*.tmp.*"))


def _runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
