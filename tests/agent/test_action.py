"""Long actions of a plugin, as its author writes them and as others see them."""

import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.agent.action import Actions
from robrain.agent.event import Event, Mailbox
from robrain.agent.lifecycle.transitions import Trigger
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.action_messages import ActionEnd, ActionProgress, Outcome
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT
from robrain.protocol.messages.team.team_messages import HALT, Halt
from robrain.protocol.workers import OwnedThread, close_threads

OVEN = """
    from robrain.agent.action import Action, Actions
    from robrain.protocol.messages.robots.action_messages import ActionEnd, ActionProgress

    class Oven(Device):
        period_s = 0.02
        progress = Event[ActionProgress](outside=True)
        finished = Event[ActionEnd](outside=True)

        def init(self):
            self.actions = Actions(self.env, self.progress, self.finished)
            self.baked = {}

        @external
        def bake(self, steps: int) -> str:
            action = self.actions.start("bake")
            self.baked[action.id] = [0, steps]
            return action.id

        @external
        def cancel(self, action: str) -> bool:
            return self.actions.cancel(action)

        def step(self):
            for action in self.actions.running():
                baked = self.baked[action.id]
                baked[0] += 1
                action.progress(baked[0] / baked[1])
                if baked[1] < 0:
                    action.fail("there is no dough")
                elif baked[0] >= baked[1]:
                    action.done("bread")
"""


def oven(bench):
    bench.code("oven", OVEN)
    bench.manifest("oven", "oven:Oven")
    bench.inbox = Inbox()
    bench.wire.subscribe(bench.inbox, ROBOT_EVENT)
    bench.start("oven")
    return bench


def told(bench, event="finished"):
    messages = [received.message for received in bench.inbox.drain()]
    return [message.value for message in messages if message.event == event]


def test_starting_returns_an_id_at_once_and_the_end_is_told_with_it(bench):
    oven(bench)
    action = bench.call("oven", "bake", [10])
    assert action == "bake-1"
    assert told(bench) == []
    bench.tick(10)
    assert told(bench) == [{"action": action, "outcome": "done", "why": "", "result": "bread"}]
    bench.tick(20)
    assert told(bench) == []


def test_progress_is_told_twice_a_second_however_often_it_is_reported(bench):
    oven(bench)
    bench.call("oven", "bake", [100])
    bench.tick(100)
    progress = told(bench, "progress")
    assert [one["action"] for one in progress] == ["bake-1"] * len(progress)
    assert [one["share"] for one in progress] == pytest.approx([0.25, 0.5, 0.75, 1.0])


def test_what_runs_ends_as_cancelled_in_an_emergency_halt_and_does_not_go_on_after_it(bench):
    oven(bench)
    action = bench.call("oven", "bake", [100])
    halts = bench.wire.publisher(HALT)
    halts.put(Halt(halted=True, by="ann"))
    bench.tick(1)
    assert [(end["action"], end["outcome"], end["why"]) for end in told(bench)] == [
        (action, "cancelled", "emergency halt")
    ]
    halts.put(Halt(halted=False, by="ann"))
    bench.tick(200)
    assert told(bench) == []


def test_who_asks_to_be_told_of_the_end_with_each_activation_is_told_once_a_time(bench):
    bench.code(
        "asker",
        """
        class Asker(Device):
            def init(self):
                self.told = []
                self.env.at_end(lambda why: self.told.append("init"))
            def activate(self):
                self.env.at_end(self.broken)
                self.env.at_end(lambda why: self.told.append("activate"))
            def broken(self, why): raise RuntimeError(why)
        """,
    )
    bench.manifest("asker", "asker:Asker")
    bench.start("asker")
    asker, tag = bench.plugin("asker"), bench.hosts[-1].manager.get("asker")
    for _ in range(3):
        asker.told.clear()
        tag.apply(Trigger.DEACTIVATE)
        assert asker.told == ["init", "activate"]
        tag.activate()


# -- the desk alone -------------------------------------------------------------------------------------------------


class Plugin:
    progress = Event[ActionProgress]()
    finished = Event[ActionEnd]()


class Env:
    def __init__(self):
        self.clock = VirtualClock()
        self.at_end = lambda function: None
        self.caller = ""


class Heard:
    """A desk, and all that it has told."""

    def __init__(self):
        self.env, plugin, self.mailbox = Env(), Plugin(), Mailbox(10_000)
        self.progress, self.ends = [], []
        plugin.progress.add(self.progress.append, self.mailbox)
        plugin.finished.add(self.ends.append, self.mailbox)
        self.desk = Actions(self.env, plugin.progress, plugin.finished)


steps = st.lists(
    st.tuples(st.sampled_from(["start", "done", "fail", "cancel", "by id", "all", "progress"]), st.integers(0, 30))
)


@given(steps)
def test_each_action_ends_exactly_once_whatever_is_called_when(steps):
    heard = Heard()
    actions = []
    for step, number in steps:
        heard.env.clock.advance_to(heard.env.clock.now_ns() + to_ns(0.05))
        if step == "start":
            before = heard.desk.running()
            actions.append(heard.desk.start("act"))
            assert all(action.end.outcome is Outcome.SUPERSEDED for action in before)
            assert heard.desk.running() == [actions[-1]]
        elif step == "all":
            heard.desk.cancel_all("enough")
        elif actions:
            action = actions[number % len(actions)]
            was_running = action.is_running
            match step:
                case "done":
                    action.done(number)
                case "fail":
                    action.fail("no")
                case "cancel":
                    action.cancel("no")
                case "by id":
                    assert heard.desk.cancel(action.id) is was_running
                case "progress":
                    action.progress(number / 20)
            assert action.is_running is (was_running and step == "progress")
    heard.desk.cancel_all("the end")
    heard.mailbox.deliver()
    assert heard.desk.running() == []
    assert len({action.id for action in actions}) == len(actions)
    assert sorted(end.action for end in heard.ends) == sorted(action.id for action in actions)
    assert {action.id: action.end for action in actions} == {end.action: end for end in heard.ends}
    assert all(0 <= progress.share <= 1 for progress in heard.progress)


def test_of_threads_that_end_one_action_together_one_has_its_way():
    for _ in range(50):
        heard = Heard()
        action = heard.desk.start("act")
        gate = threading.Barrier(3)

        def end(function, *args, gate=gate):
            gate.wait()
            function(*args)

        ways = ((action.done, 1), (action.fail, "no"), (heard.desk.cancel_all, "halt"))
        close_threads([OwnedThread("end", end, *way) for way in ways], 60.0)
        heard.mailbox.deliver()
        assert heard.ends == [action.end]
        assert heard.ends[0].outcome in set(Outcome)
