"""How long processes waited for a core: of real ones, and from files as the kernel writes them."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from robrain.deploy.supervision.part import CoreWait

SPIN = "while True: pass"


def write(proc: Path, **waited_ns: int) -> None:
    for thread, waited in waited_ns.items():
        folder = proc / "7" / "task" / thread.removeprefix("t")
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "schedstat").write_text(f"123456 {waited} 8\n")


def test_thread_that_waited_longest_counts_and_new_threads_count_from_their_first_sight(tmp_path: Path) -> None:
    wait = CoreWait(7, tmp_path)
    write(tmp_path, t7=1_000_000_000, t8=0)
    assert wait.since_last_s() == 0.0
    write(tmp_path, t7=1_200_000_000, t8=400_000_000, t9=5_000_000_000)
    assert wait.since_last_s() == pytest.approx(0.4)
    write(tmp_path, t9=5_100_000_000)
    assert wait.since_last_s() == pytest.approx(0.1)


def test_after_it_was_forgotten_the_next_call_is_the_first(tmp_path: Path) -> None:
    wait = CoreWait(7, tmp_path)
    write(tmp_path, t7=0)
    wait.since_last_s()
    wait.forget()
    write(tmp_path, t7=900_000_000)
    assert wait.since_last_s() == 0.0


def test_where_nothing_is_known_nothing_was_waited(tmp_path: Path) -> None:
    wait = CoreWait(7, tmp_path)
    assert (wait.since_last_s(), wait.since_last_s()) == (0.0, 0.0)
    write(tmp_path, t7=0)
    (tmp_path / "7" / "task" / "7" / "schedstat").write_text("nonsense\n")
    assert (wait.since_last_s(), wait.since_last_s()) == (0.0, 0.0)


@pytest.mark.slow
def test_process_whose_core_is_taken_waits_and_one_that_is_stopped_does_not() -> None:
    core = {min(os.sched_getaffinity(0))}
    spinners = [subprocess.Popen([sys.executable, "-c", SPIN]) for _ in range(3)]
    try:
        for each in spinners:
            os.sched_setaffinity(each.pid, core)
        wait = CoreWait(spinners[0].pid)
        wait.since_last_s()
        began_s = time.monotonic()
        time.sleep(1.0)
        waited_s, took_s = wait.since_last_s(), time.monotonic() - began_s
        assert 0.3 * took_s < waited_s <= took_s + 0.1
        os.kill(spinners[0].pid, 19)
        time.sleep(0.1)
        wait.since_last_s()
        time.sleep(0.5)
        assert wait.since_last_s() < 0.01
    finally:
        for each in spinners:
            each.kill()
            each.wait()
