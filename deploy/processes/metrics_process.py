"""`robrain metrics`: a team's metrics for Prometheus, on a port of this machine alone."""

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator

from msgspec import UNSET
from prometheus_client import CollectorRegistry, start_http_server
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from robrain.deploy.command_line.output import print_result
from robrain.deploy.processes.live_process import LiveStop, wire_when_there
from robrain.protocol.clock import steps, to_seconds
from robrain.protocol.errors import CallError, NobodyThere, PortInUse
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT, ROBOT_PLUGINS, PluginInfo
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_STATE, RobotState
from robrain.protocol.messages.tasks.offer_messages import TASK_EVENT, TaskEvent
from robrain.protocol.messages.team.recorder_messages import RECORDER_STATE, RecorderState
from robrain.protocol.messages.team.team_messages import COORDINATOR_ALIVE, COORDINATOR_STATE, TeamState
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.refusals import Refusal
from robrain.protocol.wire.endpoint import Endpoint

ROBOTS_MAX = 1000
TASKS_MAX = 100_000
"""Tasks whose state is kept; further ended ones are forgotten, oldest first, and stay counted."""
ASK_TIMEOUT_S = 1.0
RECEIVED = (ROBOT_STATE, COORDINATOR_STATE, RECORDER_STATE, TASK_EVENT, ROBOT_EVENT)
METRICS = {
    "robrain_messages": "Messages heard, by topic",
    "robrain_refused": "Messages refused or lost, by component, topic and code",
    "robrain_coordinator_up": "Whether a coordinator is there",
    "robrain_robot_up": "Whether a robot's token is there",
    "robrain_robot_halted": "Whether a robot is halted",
    "robrain_robot_soc_ratio": "State of charge, 0 to 1",
    "robrain_robot_state_age_seconds": "Age of a robot's last state",
    "robrain_robot_state_period_seconds": "Longest time between two states since the last scrape, by their stamps",
    "robrain_robot_faulted_plugins": "Plugins that do not run",
    "robrain_robot_left_out": "Telemetry left out on a thin link",
    "robrain_plugin_restarts": "Starts of a plugin after a fault",
    "robrain_plugin_overruns": "Steps of a plugin that took longer than its period",
    "robrain_tasks": "Tasks, by state",
    "robrain_known_area_square_metres": "Floor that is known",
    "robrain_topic_stale_seconds": "Age of topics that are older than their deadline, by topic and sender",
    "robrain_recorder_lost": "Messages that a recorder has lost",
}
"""All metrics by name, as they are defined; counters are exposed with `_total` behind it."""
COUNTERS = frozenset(
    f"robrain_{name}"
    for name in ("messages", "refused", "robot_left_out", "plugin_restarts", "plugin_overruns", "recorder_lost")
)


class TeamMetrics(Collector):
    """Receives a team's messages; scraped on any thread.

    Args:
        wire: of the team; its owner closes it.

    """

    def __init__(self, wire: Endpoint) -> None:
        self._wire = wire
        self._lock = threading.Lock()
        self._inbox = Inbox(16_384, every=True)
        for topic in RECEIVED:
            wire.subscribe(self._inbox, topic)
        self._robots = wire.watch(ROBOT_ALIVE)
        self._coordinators = wire.watch(COORDINATOR_ALIVE)
        self._messages: Counter[str] = Counter()
        self._states: dict[str, RobotState] = {}
        self._periods_s: dict[str, float] = {}
        self._team: TeamState | None = None
        self._tasks: dict[str, TaskState] = {}
        self._forgotten: Counter[TaskState] = Counter()
        self._refused: dict[str, list[Refusal]] = {}
        self._lost: dict[str, int] = {}
        self._plugins: dict[str, list[PluginInfo]] = {}

    def update(self) -> None:
        """Process arrived messages; called several times a second."""
        with self._lock:
            self._robots.changes()
            self._coordinators.changes()
            for received in self._inbox.drain():
                self._messages[received.topic.name] += 1
                self._handle(received.message)

    def ask_plugins(self) -> None:
        """Ask the robots how their plugins do; called every few seconds, as it waits for them."""
        with self._lock:
            names = sorted(each["robot"] for each in self._robots.present.values())
        for name in names[:ROBOTS_MAX]:
            try:
                plugins = self._wire.ask(ROBOT_PLUGINS, timeout_s=ASK_TIMEOUT_S, robot=name)
            except (CallError, NobodyThere):  # it is stale, or has gone: other metrics report it
                continue
            with self._lock:
                self._plugins[name] = plugins

    def collect(self) -> Iterable[Metric]:
        """The metrics now."""
        self.update()
        with self._lock:
            found = list(self._families())
            self._periods_s.clear()
        return found

    def _handle(self, message: object) -> None:
        if isinstance(message, RobotState):
            before = self._states.get(message.robot)
            if before is None and len(self._states) >= ROBOTS_MAX:
                return
            if before is not None:
                period_s = to_seconds(message.stamp_ns - before.stamp_ns)
                self._periods_s[message.robot] = max(self._periods_s.get(message.robot, 0.0), period_s)
            self._states[message.robot] = message
            self._refused[message.robot] = message.refused or []
        elif isinstance(message, TeamState):
            self._team = message
            self._refused["coordinator"] = message.refused or []
        elif isinstance(message, TaskEvent):
            self._count_task(message.task.id, message.state)
        elif isinstance(message, RecorderState):
            self._lost[message.recorder] = sum(each.messages for each in message.lost)

    def _count_task(self, task: str, state: TaskState) -> None:
        self._tasks.pop(task, None)
        self._tasks[task] = state
        if len(self._tasks) > TASKS_MAX:
            oldest = next((name for name, its in self._tasks.items() if its.ended), next(iter(self._tasks)))
            self._forgotten[self._tasks.pop(oldest)] += 1

    def _families(self) -> Iterator[Metric]:
        yield _family("robrain_messages", ("topic",), (((name,), count) for name, count in self._messages.items()))
        refused: Counter[tuple[str, ...]] = Counter()
        for component, each in self._refused.items():
            for one in each:
                refused[component, one.topic, one.code] += one.count
        yield _family("robrain_refused", ("component", "topic", "code"), refused.items())
        yield _family("robrain_coordinator_up", (), [((), float(bool(self._coordinators.present)))])
        there = {each["robot"] for each in self._robots.present.values()}
        states, now_ns = self._states, self._wire.clock.now_ns()
        yield _family("robrain_robot_up", _ROBOT, (((name,), float(name in there)) for name in {*states, *there}))
        yield _of_robots("robrain_robot_halted", ((name, float(each.halted)) for name, each in states.items()))
        yield _of_robots(
            "robrain_robot_soc_ratio",
            ((name, each.battery.soc) for name, each in states.items() if each.battery is not None),
        )
        yield _of_robots(
            "robrain_robot_state_age_seconds",
            ((name, max(to_seconds(now_ns - each.stamp_ns), 0.0)) for name, each in states.items()),
        )
        yield _of_robots("robrain_robot_state_period_seconds", self._periods_s.items())
        yield _of_robots(
            "robrain_robot_faulted_plugins",
            ((name, sum(1 + len(fault.dependants) for fault in each.faulted)) for name, each in states.items()),
        )
        yield _of_robots(
            "robrain_robot_left_out",
            ((name, each.skipped) for name, each in states.items() if each.skipped is not UNSET),
        )
        plugins = [(robot, one) for robot, each in self._plugins.items() for one in each]
        names = ("robot", "plugin")
        yield _family("robrain_plugin_restarts", names, (((robot, one.name), one.restarts) for robot, one in plugins))
        yield _family("robrain_plugin_overruns", names, (((robot, one.name), one.overruns) for robot, one in plugins))
        tasks = Counter(self._tasks.values()) + self._forgotten
        yield _family("robrain_tasks", ("state",), (((str(state),), tasks[state]) for state in TaskState))
        area = [] if self._team is None else [((), self._team.known_area_m2)]
        yield _family("robrain_known_area_square_metres", (), area)
        stale = [] if self._team is None else self._team.stale or []
        yield _family(
            "robrain_topic_stale_seconds", ("topic", "sender"), (((one.topic, one.sender), one.age_s) for one in stale)
        )
        yield _family("robrain_recorder_lost", ("recorder",), (((name,), lost) for name, lost in self._lost.items()))


_ROBOT = ("robot",)


def _of_robots(name: str, values: Iterable[tuple[str, float]]) -> Metric:
    return _family(name, _ROBOT, (((robot,), value) for robot, value in values))


def _family(name: str, labels: tuple[str, ...], values: Iterable[tuple[tuple[str, ...], float]]) -> Metric:
    make = CounterMetricFamily if name in COUNTERS else GaugeMetricFamily
    family: CounterMetricFamily | GaugeMetricFamily = make(name, METRICS[name], labels=labels)
    for each, value in sorted(values):
        family.add_metric(list(each), value)
    return family


HOST = "127.0.0.1"
UPDATE_S = 0.2
FIRST_ASK_S, ASK_PLUGINS_S = 1.0, 10.0


def metrics_command(connect: str | None, team: str, port: int) -> None:
    """Serve a team's metrics until Ctrl-C; wait until the endpoint answers.

    Args:
        connect: endpoint of the team; None uses $ROBRAIN_CONNECT, else this machine's hub.
        team: its name.
        port: 0 uses a free one.

    Raises:
        RobrainError: in one sentence.

    """
    should_stop = LiveStop()
    with wire_when_there("metrics", connect, team, should_stop) as wire:
        if wire is not None:
            serve_metrics(wire, port, should_stop, lambda url: print_result(f"metrics: of team {team} at {url}"))


def serve_metrics(wire: Endpoint, port: int, should_stop: Callable[[], bool], on_ready: Callable[[str], None]) -> None:
    """Serve metrics of the wire's team on loopback until `should_stop`.

    Raises:
        PortInUse: another process listens there.

    """
    metrics, registry = TeamMetrics(wire), CollectorRegistry()
    registry.register(metrics)
    try:
        server, thread = start_http_server(port, addr=HOST, registry=registry)
    except OSError as error:
        raise PortInUse(f"port taken: another process listens on {HOST}:{port}; give another, or 0") from error
    try:
        on_ready(f"http://{HOST}:{server.server_address[1]}/metrics")
        ask_s = time.monotonic() + FIRST_ASK_S
        for _ in steps(should_stop, UPDATE_S):
            metrics.update()
            if time.monotonic() >= ask_s:
                metrics.ask_plugins()
                ask_s = time.monotonic() + ASK_PLUGINS_S
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
