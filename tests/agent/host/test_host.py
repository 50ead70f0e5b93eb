from itertools import pairwise

import pytest

from robrain.protocol.errors import NobodyThere
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.plugin_messages import ROBOT_PLUGINS
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_STATE
from robrain.protocol.model.geometry import Pose2D

DICE = """
    from robrain.protocol.model.geometry import Pose2D

    class Dice(Device):
        period_s = 0.1
        def init(self): self.steps = []
        def step(self): self.steps.append(self.env.clock.now_ns())
        @external
        def throw(self) -> list[int]: return self.env.rng.integers(0, 1000, 8).tolist()

    class Fast(Dice):
        period_s = 0.02

    class Writer(Device):
        def activate(self):
            self.env.board.pose = Pose2D(1.0, 2.0, 0.5)
            self.env.board.behavior = "writing"
            self.env.board.radius_m = 0.3
"""


@pytest.fixture
def dice(bench):
    bench.code("dice", DICE)
    for name, class_name in {"dice": "Dice", "other": "Dice", "fast": "Fast", "writer": "Writer"}.items():
        bench.manifest(name, f"dice:{class_name}")
    return bench


def throws(bench, plugin, **options):
    host = bench.start(plugin, **options)
    thrown = bench.call(plugin, "throw", robot=host.name)
    host.close()
    return thrown


# -- randomness -------------------------------------------------------------------------------------------------


def test_equal_seeds_throw_equally(dice):
    thrown = throws(dice, "dice", seed=7)
    assert throws(dice, "dice", seed=7) == thrown
    for plugin, options in (("dice", {"seed": 8}), ("other", {"seed": 7}), ("dice", {"seed": 7, "robot": "r2"})):
        assert throws(dice, plugin, **options) != thrown
    host = dice.start("fast", "other", "dice", seed=7)  # other plugins change nothing
    assert dice.call("dice", "throw", robot=host.name) == thrown


# -- steps ------------------------------------------------------------------------------------------------------


def test_plugins_step_at_their_own_periods_from_the_first_tick(dice):
    dice.start("dice", "fast")
    dice.tick(20)
    tick_ns = 20_000_000
    assert dice.plugin("fast").steps == [tick_ns * number for number in range(1, 21)]
    slow = dice.plugin("dice").steps
    assert slow[0] == tick_ns
    assert 4 <= len(slow) <= 5
    assert all(later - earlier >= 4 * tick_ns for earlier, later in pairwise(slow))


# -- on the wire ------------------------------------------------------------------------------------------------


def test_a_robot_is_there_from_its_start_until_it_closes(dice):
    presence = dice.wire.watch(ROBOT_ALIVE)
    host = dice.host("dice")
    assert presence.changes() == []
    host.start()
    assert [(change.names["robot"], change.present) for change in presence.changes()] == [("r1", True)]
    host.close()
    assert [(change.names["robot"], change.present) for change in presence.changes()] == [("r1", False)]
    with pytest.raises(NobodyThere):
        dice.wire.ask(ROBOT_PLUGINS, robot="r1")


def test_what_plugins_write_on_the_board_is_told_ten_times_a_second(dice):
    inbox = Inbox(every=True)
    dice.wire.subscribe(inbox, ROBOT_STATE)
    dice.start("writer")
    dice.tick(50)  # one second
    messages = [received.message for received in inbox.drain()]
    assert 10 <= len(messages) <= 11
    state = messages[-1]
    assert (state.robot, state.pose, state.behavior, state.radius_m) == ("r1", Pose2D(1.0, 2.0, 0.5), "writing", 0.3)
    assert not state.halted
    assert [message.seq for message in messages] == list(range(len(messages)))


def test_a_robot_can_be_closed_twice_and_before_it_was_started(dice):
    host = dice.host("dice")
    host.close()
    host.close()
    started = dice.start("dice")
    started.close()
    started.close()
