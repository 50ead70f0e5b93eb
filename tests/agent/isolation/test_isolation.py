"""Plugins in a process of their own are, for their robot, plugins like any other."""

import os
import threading
from typing import Protocol

import msgspec
import numpy as np
import pytest

from robrain.agent import plugin_traceback
from robrain.agent.errors import AccessDenied, PluginBusy, PluginError
from robrain.agent.event import Event
from robrain.agent.isolation.isolated_plugin import IsolatedPlugin
from robrain.agent.lifecycle.external_function import external_functions
from robrain.agent.plugin import Level
from robrain.protocol.clock import LiveClock
from robrain.protocol.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.messages.robots.plugin_messages import ROBOT_FOREIGN_CALL
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import listening_at, open_session
from robrain.protocol.workers import OwnedThread, close_threads
from tests.agent.isolation.isolation_bench import IsolationBench, StandInEnvironment
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.slow

VISION = """
class Blob(msgspec.Struct, frozen=True):
    place: Point2D
    pixels: int

class VisionInterface(Protocol):
    seen: Event[Blob]
    threshold: float
    def find(self, image: NDArray[np.uint8], least: int = 1) -> list[Blob]: ...
    def process(self) -> int: ...

class Vision(Unit):
    '''Finds blobs.'''
    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        threshold: float = 0.5
        at: Point2D = Point2D(1.0, 2.0)
    interface = VisionInterface
    seen = Event[Blob]()
    period_s = 0.25
    steps = 0
    def init(self): self.threshold = self.parameters.threshold
    def step(self):
        self.steps += 1
        self.seen.notify(Blob(self.parameters.at, self.steps))
    def find(self, image, least=1):
        assert isinstance(image, np.ndarray) and image.dtype == np.uint8, image
        pixels = int((image > 255 * self.threshold).sum())
        return [Blob(self.parameters.at, pixels)] if pixels >= least else []
    def process(self): return os.getpid()
    @external
    def count(self, of: str, times: int = 2) -> dict[str, int]:
        '''Counts.'''
        return {of: self.steps * times}
"""


class Blob(msgspec.Struct, frozen=True):
    place: Point2D
    pixels: int


class RangerInterface(Protocol):
    measured: Event[float]
    reach_m: float

    def measure(self, angle_rad: float, samples: int = 1) -> Point2D: ...


class Ranger:
    """A plugin of a lower level, in the robot's own process."""

    measured = Event[float]()
    reach_m = 4.0

    def measure(self, angle_rad: float, samples: int = 1) -> Point2D:
        if samples < 1:
            raise ValueError("expected samples >= 1")
        self.thread = threading.current_thread()
        return Point2D(angle_rad, float(samples))


RANGED = """
from tests.agent.isolation.test_isolation import RangerInterface

class Vision(Unit):
    heard = ()
    def activate(self):
        self.ranger = self.env.use("ranger", RangerInterface)
        self.env.observe(self.ranger.measured, self.hear)
    def hear(self, value): self.heard = (*self.heard, value)
"""


@pytest.fixture
def bench(tmp_path):
    bench = IsolationBench(tmp_path)
    yield bench
    bench.close()


@pytest.fixture
def ranged(bench):
    """Start a plugin that uses the ranger, with this code."""
    return lambda code: bench.start(RANGED + code)


def observed(bench, event):
    """What is told of an event, in order."""
    told = []
    event.add(told.append, bench.env.mailbox)
    return told


def deliver(bench):
    """Wait for an event of the plugin, and deliver it."""
    assert bench.env.arrived.wait(PATIENCE_S)
    bench.env.mailbox.deliver()


def test_isolated_plugin_looks_like_the_real_one(bench):
    vision = bench.make(VISION)
    assert isinstance(vision, IsolatedPlugin)
    kind = type(vision)
    assert (kind.__name__, kind.__doc__, kind.level, kind.period_s) == ("Vision", "Finds blobs.", Level.UNIT, 0.25)
    assert kind.interface.__name__ == "VisionInterface"
    assert msgspec.structs.fields(kind.Parameters)[0].name == "threshold"
    (count,) = external_functions(kind).values()
    (info,) = count.infos
    assert (info.name, info.doc) == ("count", "Counts.")
    assert "times" in info.signature


def test_functions_run_in_another_process_and_take_and_give_back_what_they_declare(bench):
    vision = bench.start(VISION, parameters={"threshold": 0.1, "at": {"x_m": 3.0, "y_m": 4.0}})
    assert vision.process() == vision.pid != os.getpid()
    image = np.zeros((4, 5), np.uint8)
    assert vision.find(image) == []
    image[1, 2:4] = 255
    (blob,) = vision.find(image, least=2)
    assert (blob.place, blob.pixels, type(blob).__name__) == (Point2D(3.0, 4.0), 2, "Blob")
    assert vision.threshold == 0.1
    with pytest.raises(TypeError, match="find: Expected `int`"):
        vision.find(image, least="many")
    with pytest.raises(TypeError, match="unexpected keyword argument 'most'"):
        vision.find(image, most=1)
    with pytest.raises(TypeError, match="lock is not plain data"):
        vision.find(threading.Lock())
    assert vision.process() == vision.pid


def test_steps_happen_in_it_and_its_events_are_told_here(bench):
    vision = bench.start(VISION)
    told = observed(bench, vision.seen)
    vision.step()
    vision.step()
    bench.env.mailbox.deliver()
    assert [(blob.place, blob.pixels) for blob in told] == [(Point2D(1.0, 2.0), 1), (Point2D(1.0, 2.0), 2)]


def test_calls_to_lower_plugins_come_back_here_on_the_callers_thread(bench, ranged):
    ranger = bench.env.others["ranger"] = Ranger()
    vision = ranged("""
    @external
    def look(self) -> Point2D: return self.ranger.measure(0.5, samples=3)
    @external
    def reach(self) -> float: return self.ranger.reach_m
    """)
    assert vision.look() == Point2D(0.5, 3.0)
    assert ranger.thread is threading.current_thread()
    assert vision.reach() == 4.0
    assert bench.env.asked == [("ranger", RangerInterface)]


def test_calls_from_its_own_threads_come_back_here_too(bench, ranged):
    bench.env.others["ranger"] = Ranger()
    vision = ranged("""
    looked = Event[Point2D]()
    @external
    def look_aside(self) -> None:
        threading.Thread(target=lambda: self.looked.notify(self.ranger.measure(0.5))).start()
    """)
    told = observed(bench, vision.looked)
    vision.look_aside()
    deliver(bench)
    assert told == [Point2D(0.5, 1.0)]


def test_events_of_lower_plugins_reach_it_in_its_turn(bench, ranged):
    ranger = bench.env.others["ranger"] = Ranger()
    vision = ranged("""
    @external
    def all_heard(self) -> list[float]: return list(self.heard)
    """)
    ranger.measured.notify(1.5)
    ranger.measured.notify(2.5)
    assert vision.all_heard() == []
    bench.env.mailbox.deliver()
    assert vision.all_heard() == [1.5, 2.5]


def test_it_has_the_rights_of_its_plugin_and_no_more(bench):
    with pytest.raises(AccessDenied, match="not in the visibility of ranger") as caught:
        bench.start(RANGED)
    assert caught.value.plugin == "ranger"
    assert bench.plugins[0].pid is None


def test_what_it_raises_is_raised_here(bench):
    vision = bench.start("""
        from robrain.protocol.errors import CallError, ErrorCode
        class Odd(Exception): pass
        ERRORS = (
            ValueError("seen nothing"), PluginBusy("lamp", "r2"), CallError(ErrorCode.REFUSED, "not now"), Odd("odd")
        )
        class Vision(Unit):
            @external
            def fail(self, number: int) -> None: raise ERRORS[number]
        """)
    raised = []
    for number, (kind, text) in enumerate(
        [
            (ValueError, "seen nothing"),
            (PluginBusy, "lamp is held by r2"),
            (CallError, "not now"),
            (PluginError, "Odd: odd"),  # a class that is not known here
        ]
    ):
        with pytest.raises(kind, match=text) as caught:
            vision.fail(number)
        raised.append(caught.value)
        assert all("vision_0.py" in text for text in plugin_traceback.raised(caught.value))
    assert (raised[1].holder, raised[2].code) == ("r2", ErrorCode.REFUSED)


def test_an_unknown_error_of_a_lower_plugin_is_an_error_of_the_plugin_that_called_it(bench, ranged):
    class OutOfReach(Exception):
        pass

    class BlindRanger(Ranger):
        def measure(self, angle_rad: float, samples: int = 1) -> Point2D:
            raise OutOfReach("nothing within 4 m")

    bench.env.others["ranger"] = BlindRanger()
    vision = ranged("""
    @external
    def look(self) -> Point2D: return self.ranger.measure(0.5)
    """)
    with pytest.raises(PluginError, match="OutOfReach: nothing within 4 m") as caught:
        vision.look()
    assert caught.value.plugin == "vision"


def test_what_it_cannot_have_is_refused_in_words(bench, ranged):
    bench.env.others["ranger"] = Ranger()
    vision = ranged("""
    @external
    def wire(self) -> None: self.env.wire.ask
    @external
    def tasks(self) -> None: self.env.tasks
    @external
    def do_tasks(self) -> None: self.env.do_tasks(None, None)
    @external
    def observe(self) -> None: self.env.observe(Event(), print)
    @external
    def pry(self) -> None: self.ranger.thread
    """)
    for wish, text in (
        ("wire", "cannot reach the wire"),
        ("tasks", "has no env.tasks"),
        ("do_tasks", "cannot do tasks"),
        ("observe", "can observe events of the plugins that it uses"),
        ("pry", "thread is not in RangerInterface"),
    ):
        with pytest.raises(PluginError, match=text):
            getattr(vision, wish)()


def test_types_that_cannot_pass_between_processes_are_found_before_the_start(bench):
    with pytest.raises(PluginError, match="Vision cannot run in a separate process"):
        bench.make("""
            class VisionInterface(Protocol):
                def look(self, at: "Nowhere") -> None: ...
            class Vision(Unit):
                interface = VisionInterface
            """)


def test_calls_of_several_threads_take_turns(bench):
    vision = bench.start("""
        class Vision(Unit):
            inside = 0
            @external
            def look(self) -> int:
                self.inside += 1
                time.sleep(0.002)
                self.inside -= 1
                return self.inside
        """)
    seen = []
    close_threads(
        [OwnedThread("look", lambda: seen.extend(vision.look() for _ in range(20))) for _ in range(4)], PATIENCE_S
    )
    assert seen == [0] * 80


def test_actions_are_told_of_the_end(bench):
    vision = bench.start("""
        class Vision(Unit):
            ended = Event[str]()
            def activate(self): self.env.at_end(self.ended.notify)
        """)
    told = observed(bench, vision.ended)
    for end, why in ((vision.deactivate, "the plugin is deactivated"), (vision.emergency_halt, "emergency halt")):
        vision.activate()
        end()
        deliver(bench)
        bench.env.arrived.clear()
        assert told.pop() == why


def ask_when_there(operator):
    """What the plugin answers, as soon as it has come round between the processes that somebody answers."""
    until(lambda: not is_nobody_there(operator))
    return operator.ask(ROBOT_FOREIGN_CALL, robot="r1", plugin="vision", function="tell", timeout_s=PATIENCE_S)


def is_nobody_there(operator):
    try:
        operator.ask(ROBOT_FOREIGN_CALL, robot="r1", plugin="vision", function="tell", timeout_s=PATIENCE_S)
    except NobodyThere:
        return True
    return False


def test_it_has_a_place_of_its_own_on_the_wire(bench, ranged):
    with open_session(mode="router", listen=["tcp/127.0.0.1:0"]) as hub:
        operator = Endpoint(hub, "default", LiveClock(), Drive.LIVE)
        bench.env = StandInEnvironment(connect=tuple(listening_at(hub)))
        bench.env.others["ranger"] = Ranger()
        vision = ranged("""
    def init(self):
        from robrain.protocol.messages.robots.plugin_messages import ROBOT_FOREIGN_CALL
        self.env.answer(ROBOT_FOREIGN_CALL, self.tell, robot=self.env.robot, plugin="vision", function="tell")
    def tell(self, request): return msgspec.json.encode([os.getpid(), self.ranger.measure(0.5).x_m])
    """)
        assert msgspec.json.decode(ask_when_there(operator)) == [vision.pid, 0.5]
        vision.deactivate()
        until(lambda: is_nobody_there(operator))  # the hub hears on a thread of its own that the process has left
        operator.close()
