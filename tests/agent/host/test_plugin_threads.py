"""Few threads give all plugins their turns, and one that hangs holds up no other."""

import threading

import pytest

from robrain.agent.host.live_drive import SPARE
from robrain.agent.lifecycle import worker_pool
from robrain.agent.lifecycle.worker_pool import WorkerPool
from tests.agent.live_robot import LiveRobot
from tests.waiting import PATIENCE_S, until

PLUGINS = """
    import threading
    GO, ENTERED = threading.Event(), []

    class Door(Device):
        @external
        def press(self) -> None: ...

    class Stepping(Device):
        period_s = 0.02
        steps = 0
        def step(self): self.steps += 1

    class Hanging(Device):
        period_s = 0.02
        def step(self):
            ENTERED.append(self.env.plugin)
            GO.wait(600)

    class Odd(Device):
        period_s = 0.02
        def step(self): self.period_s = PERIODS[self.env.plugin]
    PERIODS = {"odd0": "0.1", "odd1": 0.0, "odd2": float("nan")}
"""
MANY, HUNG = 12, 4


@pytest.fixture
def start(bench):
    opened = []
    bench.code("shop", PLUGINS)

    def start(stepping, hanging, odd=0):
        names = {"door": "Door"}
        names |= {f"s{number}": "Stepping" for number in range(stepping)}
        names |= {f"h{number}": "Hanging" for number in range(hanging)}
        names |= {f"odd{number}": "Odd" for number in range(odd)}
        for name, class_name in names.items():
            bench.manifest(name, f"shop:{class_name}", hang_s=PATIENCE_S)
        opened.append(LiveRobot(bench.place, list(names), space_of="door", threads="plugin-"))
        assert opened[-1].ready.wait(PATIENCE_S)
        return opened[-1]

    yield start
    for robot in opened:
        robot.close()


def plugin_threads():
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("plugin-")]


def steps(robot, count):
    return [robot.tag(f"s{number}").plugin.steps for number in range(count)]


def test_many_plugins_that_take_no_time_share_a_few_threads(start):
    robot = start(MANY, 0)
    until(lambda: min(steps(robot, MANY)) > 20)
    assert robot.tag("door").mailbox.wake is not None
    until(lambda: len(plugin_threads()) <= SPARE + 1)


def test_each_plugin_that_hangs_takes_one_thread_and_the_others_go_on(start):
    robot = start(MANY, HUNG)
    until(lambda: len(robot.space["ENTERED"]) == HUNG)
    before = steps(robot, MANY)
    until(lambda: all(now > then + 20 for now, then in zip(steps(robot, MANY), before, strict=True)))
    assert {f"plugin-h{number}" for number in range(HUNG)} <= set(plugin_threads())
    until(lambda: len(plugin_threads()) <= HUNG + SPARE + 1)
    robot.space["GO"].set()
    until(lambda: len(plugin_threads()) <= SPARE + 1)


@pytest.mark.slow
def test_a_plugin_whose_period_is_none_is_faulted_and_the_others_go_on(start):
    robot = start(2, 0, odd=3)
    odd = [robot.tag(f"odd{number}") for number in range(3)]
    until(lambda: [plugin.state for plugin in odd] == ["faulted"] * 3)
    assert "expected period_s above 0, or None, got 0.0" in odd[1].state_reason
    before = steps(robot, 2)
    until(lambda: all(now > then + 20 for now, then in zip(steps(robot, 2), before, strict=True)))


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


def test_quick_calls_need_no_more_threads_than_stand_by(monkeypatch):
    monkeypatch.setattr(worker_pool, "STALL_S", PATIENCE_S)  # on a busy machine no call may be back after two ms
    pool = WorkerPool("test", PATIENCE_S)
    pool.stand_by(2)
    failed = pool.run({str(number): lambda: None for number in range(20)})
    threads = [thread for thread in threading.enumerate() if thread.name.startswith("test-")]
    pool.close()
    assert failed == {}
    assert len(threads) <= 3


def test_a_thread_that_has_nothing_to_do_for_long_ends_and_the_next_call_gets_another():
    pool, done = WorkerPool("test", PATIENCE_S, idle_s=0.05), threading.Event()
    assert pool.run({"one": lambda: None}) == {}
    until(lambda: not any(thread.name.startswith("test-") for thread in threading.enumerate()))
    pool.begin(done.set)
    assert done.wait(PATIENCE_S)
    pool.close()
