"""Threads that make calls side by side."""

import threading

from robrain.agent.lifecycle.worker_pool import WorkerPool
from tests.waiting import PATIENCE_S, until


def test_calls_that_wait_behind_stuck_ones_get_threads_of_their_own():
    pool, go = WorkerPool("test", PATIENCE_S), threading.Event()
    pool.stand_by(2)
    stuck = {f"stuck{number}": lambda: go.wait(600) for number in range(3)}
    done = threading.Event()
    running = threading.Thread(target=pool.run, args=(stuck | {"last": done.set},))
    running.start()
    assert done.wait(PATIENCE_S)
    go.set()
    running.join(PATIENCE_S)
    pool.close()
    until(lambda: not any(thread.name.startswith("test-") for thread in threading.enumerate()))


def test_a_thread_that_has_nothing_to_do_for_long_ends_and_the_next_call_gets_another():
    pool, done = WorkerPool("test", PATIENCE_S, idle_s=0.05), threading.Event()
    assert pool.run({"one": lambda: None}) == {}
    until(lambda: not any(thread.name.startswith("test-") for thread in threading.enumerate()))
    pool.begin(done.set)
    assert done.wait(PATIENCE_S)
    pool.close()
