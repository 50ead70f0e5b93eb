"""What a robot's plugins print and log is in its log, under their names."""

import sys

import pytest

from robrain.agent.plugin_output import LINES_PER_S, PluginOutput
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.host_messages import HOST_LOAD, LoadRequest
from robrain.protocol.messages.robots.plugin_messages import ROBOT_LOG, ROBOT_LOG_KEPT
from tests.agent.live_robot import LiveRobot
from tests.waiting import PATIENCE_S, until

DOOR = """
    import threading
    GO = threading.Event()
    def shout(text): print(text)

    class Hall(Protocol):
        def echo(self, text: str) -> None: ...

    class Door(Device):
        interface = Hall
        @external
        def press(self) -> None: print("pressed\\nand", "released")
        def echo(self, text): shout(text)
"""
TALKER = """
    import logging, sys, threading
    from hall import Hall
    print("imported")

    class Talker(Unit):
        def init(self): print("made")
        def activate(self): self.door = self.env.use("door", Hall)
        def other_thread(self): print("from", "a thread")
        @external
        def talk(self) -> None:
            print("be", end="gin")
            self.door.echo("called")
            sys.stdout.write("\\n")
            thread = threading.Thread(target=self.other_thread)
            thread.start()
            thread.join()
            print("to stderr", file=sys.stderr)
            logging.warning("careful")
            logging.getLogger("any").info("one of %d", 2)
            logging.debug("hidden")
            try: 1 / 0
            except ZeroDivisionError: logging.exception("no number")
"""


@pytest.fixture
def robot(bench):
    bench.code("hall", DOOR)
    bench.manifest("door", "hall:Door", visibility=["command", "*"])
    bench.code("talk", TALKER)
    bench.manifest("talker", "talk:Talker", requires=["door"], visibility=["command"])
    opened = LiveRobot(bench.place, ["door"], space_of="door", threads="plugin-")
    assert opened.ready.wait(PATIENCE_S)
    yield opened
    opened.close()


@pytest.mark.parametrize("isolation", ["none", "process"])
def test_lines_have_the_name_of_the_plugin_whose_code_runs(robot, bench, isolation):
    bench.manifest("talker", "talk:Talker", requires=["door"], visibility=["command"], isolation=isolation)
    heard = Inbox()

    def kept():
        return robot.wire.ask(ROBOT_LOG_KEPT, robot="r1")

    def texts(plugin):
        return [record.text for record in kept() if record.source == plugin]

    robot.wire.subscribe(heard, ROBOT_LOG)
    with robot.host.log.plugin_output():
        robot.wire.ask(HOST_LOAD, LoadRequest(plugin="talker"), robot="r1")
        robot.call("talker", "talk")
        robot.call("door", "press")
        sys.stdout.write("of nobody\n")
        until(lambda: "from a thread" in texts("talker"))  # a process of its own sends it on another connection
    assert texts("door") == ["called", "pressed", "and released"]
    said = {record.text.partition("\n")[0]: record.level for record in kept() if record.source == "talker"}
    lines = ["imported", "made", "begin", "from a thread", "to stderr", "one of 2"]
    assert said == {**dict.fromkeys(lines, "info"), "careful": "warning", "no number": "error"}
    received = []
    until(lambda: received.extend(each.message.text for each in heard.drain()) or len(received) == len(kept()))
    assert received == [record.text for record in kept()]


def test_lines_above_the_limit_are_dropped_and_counted():
    clock, lines = VirtualClock(), []
    output = PluginOutput(lambda *line: lines.append(line), lambda: "lamp", clock)
    accepted = [output.accept("lamp", "info", str(number)) for number in range(LINES_PER_S + 7)]
    assert accepted == [True] * LINES_PER_S + [False] * 7
    assert output.accept("other", "info", "is not limited by it")
    output.report_dropped()
    assert len(lines) == LINES_PER_S + 1  # the second is not over
    clock.advance_to(to_ns(1.0))
    output.report_dropped()
    output.report_dropped()
    assert output.accept("lamp", "info", "next")
    dropped, last = lines[LINES_PER_S + 1 :]
    assert dropped[:2] == ("lamp", "warning")
    assert dropped[2].startswith("7 lines dropped")
    assert last == ("lamp", "info", "next")
