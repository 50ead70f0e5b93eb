"""One ROS 2 node of this process, with its context, executor and the thread that spins it.

All plugins of a robot share it. It ends `LINGER_S` after the last plugin has released it, at the latest with the
process. Restarted plugins thus find it with its discovered publishers.
"""

import atexit
import logging
import re
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from typing import Annotated, Any, ClassVar, Generic, NamedTuple, TypeVar

import rclpy
import rclpy.context
import rclpy.executors
from msgspec import Meta
from rclpy.duration import Duration

from robrain.agent.environment import Environment
from robrain.agent.errors import HardwareAbsent
from robrain.protocol.clock import LiveClock
from robrain.protocol.model.checked import Checked
from robrain.protocol.ros2.ros_names import DOMAIN_MAX, environment_domain
from robrain.protocol.wire.endpoint import Drive
from robrain.protocol.workers import OwnedThread

_NAMESPACE = re.compile(r"(/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*)?")
_TOPIC = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")


class Ros2Parameters(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where the robot's topics are."""

    namespace: str = ""
    """Namespace of the robot's topics, such as `/r7`; topics that begin with `/` are not in it."""
    domain_id: Annotated[int, Meta(ge=0, le=DOMAIN_MAX)] | None = None
    """ROS domain; absent: `$ROS_DOMAIN_ID`, otherwise 0."""

    topics: ClassVar[tuple[str, ...]] = ()
    """The parameters that are names of topics."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not _NAMESPACE.fullmatch(self.namespace):
            raise ValueError(f"expected namespace as in /r7, got {self.namespace!r}")
        for name in self.topics:
            topic = getattr(self, name)
            if not _TOPIC.fullmatch(topic):
                raise ValueError(f"expected {name} to be a topic such as odom or /odom, got {topic!r}")

    def topic(self, name: str) -> str:
        """The full name of a topic.

        >>> Ros2Parameters(namespace="r7").topic("odom")
        '/r7/odom'
        """
        if name.startswith("/"):
            return name
        namespace = self.namespace.strip("/")
        return f"/{namespace}/{name}" if namespace else f"/{name}"


M = TypeVar("M")
INBOX_MESSAGES = 256


class Arrived(NamedTuple, Generic[M]):
    """A received message."""

    message: M
    arrived_ns: int
    """Time of its arrival, ns since 1970."""
    number: int
    """Its publisher's count of messages; 0 if the middleware has none."""


class Ros2Inbox(Generic[M]):
    """Messages of one topic; at most `INBOX_MESSAGES`, the oldest are dropped.

    Args:
        on_arrival: called after each message, on the thread of the node.

    """

    close: Callable[[], object]
    """Unsubscribes."""

    def __init__(self, on_arrival: Callable[[], None]) -> None:
        self.dropped = 0
        self._on_arrival = on_arrival
        self._messages: deque[Arrived[M]] = deque(maxlen=INBOX_MESSAGES)

    def __len__(self) -> int:
        return len(self._messages)

    def put(self, message: M, arrived_ns: int, number: int = 0) -> None:
        """Add a message; on the thread of the node."""
        self.dropped += len(self._messages) == INBOX_MESSAGES
        self._messages.append(Arrived(message, arrived_ns, number))
        self._on_arrival()

    def drain(self) -> list[Arrived[M]]:
        """Remove and return all messages, in order of arrival."""
        return [self._messages.popleft() for _ in range(len(self._messages))]


logger = logging.getLogger(__name__)

R = TypeVar("R")

LINGER_S = 60.0
SPIN_S = 0.2
JOIN_S = 5.0
DO_S = 5.0
DISCOVERY_S = 5.0
"""Time after which a node has discovered all publishers."""
ACKNOWLEDGE_S = 0.1
"""How long the end of a publisher waits until its last message is acknowledged."""
ARGUMENTS = ["--ros-args", "--disable-external-lib-logs"]
"""No log files in the user's home folder: errors are in the agent's log."""

_NOT_IN_NAMES = re.compile(r"[^A-Za-z0-9_]")
_links: "dict[tuple[str, int], Ros2Link]" = {}
_links_lock = threading.Lock()


class Ros2Link:
    """A node and the thread that spins it; made by `open_link`.

    Args:
        name: the node's name.
        domain_id: its ROS domain.

    """

    def __init__(self, name: str, domain_id: int) -> None:
        self.domain_id = domain_id
        self.failure = ""
        """Reason why the node no longer spins; empty while it does."""
        self.users = 1
        self._released_s, self._opened_s = 0.0, time.monotonic()
        self._context = rclpy.context.Context()
        rclpy.init(args=ARGUMENTS, context=self._context, domain_id=domain_id)
        self.node: Any = rclpy.create_node(
            name, context=self._context, enable_rosout=False, start_parameter_services=False
        )
        self._executor = rclpy.executors.SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._closing = threading.Event()
        self._asked: deque[tuple[Callable[[], Any], Future[Any]]] = deque()
        self._asking = threading.Lock()
        self._thread = OwnedThread(f"ros2-{name}", self._spin)

    def subscribe(
        self, kind: type[Any], topic: str, qos: Any, on_arrival: Callable[[], None], *, raw: bool = False
    ) -> Ros2Inbox[Any]:
        """Subscribe to a topic.

        Args:
            kind: the message's class.
            topic: its full name.
            qos: `rclpy.qos.QoSProfile`.
            on_arrival: called after each message, on the thread of the node.
            raw: messages are taken as their bytes.

        """
        inbox, clock = Ros2Inbox[Any](on_arrival), LiveClock()

        def receive(message: Any, info: dict[str, int | None]) -> None:
            arrived_ns = clock.of_wall_ns(info["received_timestamp"] or time.time_ns())
            inbox.put(message, arrived_ns, info["publication_sequence_number"] or 0)

        subscription = self.do(lambda: self.node.create_subscription(kind, topic, receive, qos, raw=raw))
        inbox.close = lambda: self.end(lambda: self.node.destroy_subscription(subscription))
        return inbox

    def publisher(self, kind: type[Any], topic: str, qos: Any) -> "Ros2Publisher":
        """Publish on a topic; arguments as for `subscribe`."""
        return self.do(lambda: Ros2Publisher(self, kind, topic, qos))

    def every(self, period_s: float, function: Callable[[], None]) -> Callable[[], None]:
        """Call a function on the thread of the node; returns a function that ends this."""
        timer = self.do(lambda: self.node.create_timer(period_s, function))
        return lambda: self.end(lambda: self.node.destroy_timer(timer))

    def do(self, function: Callable[[], R]) -> R:
        """Have a function called on the thread of the node, between two messages, and wait for that.

        The executor fails if an entity that it waits for is destroyed meanwhile.

        Raises:
            RuntimeError: the node no longer spins.

        """
        if self._thread.is_current:
            return function()
        done: Future[R] = Future()
        with self._asking:
            if self.failure:
                raise RuntimeError(self.failure)
            self._asked.append((function, done))
        self._executor.wake()
        return done.result(DO_S)

    def later(self, function: Callable[[], object]) -> None:
        """As `do`, without waiting; without effect once the node no longer spins."""
        with self._asking:
            if self.failure:
                return
            self._asked.append((function, Future()))
        self._executor.wake()

    def end(self, function: Callable[[], object]) -> None:
        """As `do`, for actions that end with the node in any case."""
        try:
            self.do(function)
        except (RuntimeError, TimeoutError) as error:
            logger.debug("not ended before the ROS 2 node: %s", error)

    def publishers(self, topic: str) -> int:
        """Number of known publishers of a topic."""
        return int(self.node.count_publishers(topic)) if not self.failure else 0

    def is_gone(self, topic: str) -> bool:
        """Whether a topic has no publisher, and the node has been there for long enough to know."""
        return time.monotonic() - self._opened_s > DISCOVERY_S and not self.publishers(topic)

    def release(self) -> None:
        """Remove one user."""
        with _links_lock:
            self.users -= 1
            self._released_s = time.monotonic()

    def close(self) -> None:
        """End the thread and the node; without effect the second time."""
        self._closing.set()
        if not self._thread.is_current:
            self._executor.wake()
            self._thread.close(JOIN_S)

    def _spin(self) -> None:
        try:
            while not self._closing.is_set() and not self._is_forgotten():
                self._executor.spin_once(timeout_sec=SPIN_S)
                self._run_requests()
        except (rclpy.executors.ExternalShutdownException, rclpy.executors.ShutdownException):
            self.failure = "the ROS 2 context was shut down"
        except Exception as error:  # any error of a library under rclpy is reported as the devices' fault
            self.failure = f"the ROS 2 node has failed: {error}"
            logger.exception("the ROS 2 node is not spun any more")
        finally:
            with self._asking:
                self.failure = self.failure or "the ROS 2 node was closed"
            self._run_requests()
            self._executor.shutdown(timeout_sec=0.0)
            self.node.destroy_node()
            self._context.try_shutdown()

    def _run_requests(self) -> None:
        while self._asked:
            function, done = self._asked.popleft()
            try:
                done.set_result(function())
            except Exception as error:  # noqa: BLE001 - raised again where it was asked for
                logger.debug("asked of the ROS 2 node: %s", error)
                done.set_exception(error)

    def _is_forgotten(self) -> bool:
        with _links_lock:
            if self.users > 0 or time.monotonic() - self._released_s < LINGER_S:
                return False
            for key in [key for key, link in _links.items() if link is self]:
                del _links[key]
            return True


class Ros2Publisher:
    """Publishes on a topic; see `Ros2Link.publisher`."""

    def __init__(self, link: Ros2Link, kind: type[Any], topic: str, qos: Any) -> None:
        self._link = link
        self._publisher = link.node.create_publisher(kind, topic, qos)

    def publish(self, message: Any) -> None:
        """Publish a message, or its bytes; on any thread."""
        self._publisher.publish(message)

    def listeners(self) -> int:
        """Number of known matching subscriptions."""
        return int(self._publisher.get_subscription_count())

    def close(self) -> None:
        """Stop publishing; the last message gets a moment to arrive."""
        self._link.end(self._close)

    def _close(self) -> None:
        if self.listeners():
            self._publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGE_S))
        self._link.node.destroy_publisher(self._publisher)


def open_link(env: Environment, parameters: Ros2Parameters) -> Ros2Link:
    """The node of this process, for a plugin that releases it when it is deactivated.

    Raises:
        HardwareAbsent: in lockstep, or where ROS 2 does not start.

    """
    if env.wire.drive is Drive.LOCKSTEP:
        raise HardwareAbsent(env.plugin, "a ROS 2 robot runs by the wall clock, and this run does not")
    try:
        domain_id = environment_domain() if parameters.domain_id is None else parameters.domain_id
    except ValueError as error:
        raise HardwareAbsent(env.plugin, str(error)) from error
    key = (f"robrain_{_NOT_IN_NAMES.sub('_', env.robot)}", domain_id)
    with _links_lock:
        if not _links:
            atexit.register(close_links)
        link = _links.get(key)
        if link is None or link.failure:
            try:
                link = _links[key] = Ros2Link(*key)
            except Exception as error:  # rclpy's errors have no common base
                raise HardwareAbsent(env.plugin, f"ROS 2 does not start in domain {domain_id}: {error}") from error
        else:
            link.users += 1
    return link


def close_links() -> None:
    """Close all nodes of this process."""
    with _links_lock:
        links = list(_links.values())
        _links.clear()
    for link in links:
        link.close()
