"""Threads and child processes: closed in time, or reported or killed."""

import signal
import subprocess
import sys
import threading
from queue import SimpleQueue

from robrain.protocol.workers import OwnedThread, ProcessGroup, close_threads
from tests.waiting import PATIENCE_S, has_ended, until

STUBBORN = """
import signal, subprocess, sys, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
print(subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"]).pid, flush=True)
time.sleep(600)
"""


def test_thread_that_ends_is_closed_without_a_report(caplog):
    done = []
    thread = OwnedThread("quick", done.append, 1)
    assert thread.close(PATIENCE_S)
    assert (done, thread.is_alive, thread.error, caplog.messages) == ([1], False, None, [])


def test_threads_that_do_not_end_are_reported_within_one_time_limit(caplog):
    go = threading.Event()
    threads = [OwnedThread(f"stuck-{number}", go.wait) for number in range(2)]
    close_threads(threads, 0.01)
    go.set()
    assert all(thread.close(PATIENCE_S) for thread in threads)
    assert caplog.messages == [f"the thread stuck-{number} does not end, and is abandoned" for number in range(2)]


def test_error_of_a_thread_is_logged_once_and_kept(caplog, monkeypatch):
    monkeypatch.setattr(threading, "excepthook", lambda _: None)
    thread = OwnedThread("broken", int, "x")
    assert thread.close(PATIENCE_S)
    assert isinstance(thread.error, ValueError)
    assert [record.exc_info[1] for record in caplog.records] == [thread.error]


def test_thread_that_closes_itself_does_not_wait():
    threads, ended = SimpleQueue(), []
    thread = OwnedThread("own", lambda: ended.append(threads.get().close()))
    threads.put(thread)
    assert thread.close(PATIENCE_S)
    assert (ended, thread.error) == ([False], None)


def test_process_that_ignores_sigterm_is_killed_with_what_it_has_started():
    group = ProcessGroup([sys.executable, "-c", STUBBORN], stdout=subprocess.PIPE)
    with group.process.stdout as output:
        started = int(output.readline())
        group.ask_to_end()
        assert not group.ends_within(0.1)
        group.end(0.1)
        assert group.status == -signal.SIGKILL
        until(lambda: has_ended(started))


def test_process_ends_with_its_input_and_keeps_its_status():
    script = "import os, sys; sys.stdin.read(); sys.exit(int(os.environ['WITH']))"
    group = ProcessGroup([sys.executable, "-c", script], stdin=subprocess.PIPE, environment={"WITH": "3"})
    assert group.status is None
    group.end(600.0)
    group.kill()
    assert group.status == 3
