"""`robrain vda5050 vehicle`: a vehicle of another vendor is a robot of the team; this process is its master."""

from collections.abc import Callable
from contextlib import closing, suppress

import msgspec

from robrain.deploy.command_line.output import print_message, print_result
from robrain.deploy.processes.live_process import LiveStop, live_endpoint, open_when_there
from robrain.deploy.processes.name_claim import NameWatcher, claim_robot
from robrain.deploy.vda5050.messages import Vehicle
from robrain.deploy.vda5050.mqtt_link import KEEPALIVE_S, Broker, MqttLink
from robrain.deploy.vda5050.vehicle_robot import KINDS, VEHICLE, VehicleRobot, instant_action
from robrain.protocol.clock import steps, to_ns
from robrain.protocol.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots import host_messages, robot_messages
from robrain.protocol.messages.robots.host_messages import HaltAnswer
from robrain.protocol.messages.robots.plugin_messages import ROBOT_PLUGINS, PluginInfo, TaskKind
from robrain.protocol.messages.robots.robot_messages import PlannedPath
from robrain.protocol.messages.tasks.offer_messages import ROBOT_OFFER, ROBOT_WITHDRAW
from robrain.protocol.messages.team.team_messages import COORDINATOR_HALT, COORDINATOR_STATE, HALT, HaltStatus
from robrain.protocol.messages.team.zone_messages import COORDINATOR_ZONES
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.stock_kinds import STOCK_KINDS
from robrain.protocol.refusals import Refusals, most_refused
from robrain.protocol.schema.struct_schema import parameters_schema
from robrain.protocol.wire.endpoint import Deferred, Endpoint, Request, Serve
from robrain.protocol.wire.hub import team_endpoints

PERIOD_S = 0.02
STATE_NS = to_ns(0.1)
HALT_NS = to_ns(2.0)
"""Time for a vehicle to confirm a halt."""
ASK_TIMEOUT_S = 2.0


class VehicleMember:
    """The vehicle's membership of the team: it begins with the token, and ends with `close`.

    Args:
        wire: closed with the membership.
        name: of the robot.
        robot: the vehicle.
        refusals: counts of the vehicle's messages.

    """

    def __init__(self, wire: Endpoint, name: str, robot: VehicleRobot, refusals: Refusals) -> None:
        self._wire, self._name, self._robot, self._refusals = wire, name, robot, refusals
        self._inbox = Inbox()
        self._halts: list[tuple[int, Callable[[HaltAnswer | CallError], None]]] = []
        self._published_ns = 0
        self._last: object = None
        self._path: list[Point2D] = []
        self._states = wire.publisher(robot_messages.ROBOT_STATE, robot=name)
        self._paths = wire.publisher(robot_messages.ROBOT_PATH, robot=name)
        now_ns = wire.clock.now_ns
        in_step = Serve.IN_STEP
        wire.answer(ROBOT_PLUGINS, lambda _: _plugins(), robot=name)
        wire.answer(ROBOT_OFFER, lambda request: robot.offer(request.asked, now_ns()), serve=in_step, robot=name)
        wire.answer(ROBOT_WITHDRAW, lambda request: robot.withdraw(request.asked), serve=in_step, robot=name)
        wire.answer(host_messages.HOST_HALT, self._halt, serve=in_step, robot=name)
        wire.answer(host_messages.HOST_RESUME, self._resume, serve=in_step, robot=name)
        for topic in (HALT, COORDINATOR_STATE, COORDINATOR_ZONES):
            wire.subscribe(self._inbox, topic)
        with suppress(NobodyThere, CallError):  # there is no coordinator
            self._latch(wire.ask(COORDINATOR_HALT, timeout_s=ASK_TIMEOUT_S))
        wire.token(robot_messages.ROBOT_ALIVE, robot=name)

    def step(self) -> None:
        """Answer requests, process messages and publish the vehicle's state."""
        now_ns = self._wire.clock.now_ns()
        for received in self._inbox.drain():
            message = received.message
            if received.topic is HALT:
                self._handle_halt(message.halted, message.by, message.reason, message.stamp_ns)
            elif received.topic is COORDINATOR_ZONES:
                self._robot.zones = message.zones
            else:
                self._latch(message.halt)
                for summary in message.robots:
                    if summary.name == self._name and summary.up:
                        self._robot.renew_lease(now_ns - to_ns(summary.age_s))
        self._wire.serve()
        self._answer_halts(now_ns)
        self._publish(now_ns)

    def close(self) -> None:
        """Withdraw the token and all declarations."""
        for _, reply in self._halts:
            reply(CallError(ErrorCode.UNLOADED, "the vehicle has disconnected"))
        self._wire.close()

    def _publish(self, now_ns: int) -> None:
        state = msgspec.structs.replace(self._robot.robot_state(), refused=most_refused(self._refusals))
        news = (state.task, state.halted_by, state.not_halted)
        if news != self._last or now_ns - self._published_ns >= STATE_NS:
            self._states.put(state)
            self._last, self._published_ns = news, now_ns
        path = self._robot.path
        if bool(path) != bool(self._path) or path[1:] != self._path[1:]:
            self._paths.put(PlannedPath(robot=self._name, points=path))
        self._path = path

    def _latch(self, status: HaltStatus | None) -> None:
        """Latch a halt that the coordinator reports, if it is newer than the last halt or resume received."""
        if status is not None and status.halted and status.stamp_ns > self._robot.latch.stamp_ns:
            for by in status.by:
                self._handle_halt(True, by, status.reason, status.stamp_ns)

    def _handle_halt(self, halted: bool, by: str, reason: str, stamp_ns: int) -> None:
        self._robot.team_halt_ns = max(self._robot.team_halt_ns, stamp_ns)
        if halted:
            self._robot.halt(by, reason, stamp_ns)
        else:
            self._robot.resume(by, self._wire.clock.now_ns(), stamp_ns)

    def _halt(self, request: Request[host_messages.HaltRequest]) -> Deferred[HaltAnswer]:
        self._robot.halt(request.by or request.asked.by, request.asked.reason)
        until_ns = self._wire.clock.now_ns() + HALT_NS
        return Deferred(lambda reply: self._halts.append((until_ns, reply)))

    def _resume(self, request: Request[host_messages.ResumeRequest]) -> HaltAnswer:
        reason = self._robot.resume(request.by or request.asked.by, self._wire.clock.now_ns())
        if reason:
            raise CallError(ErrorCode.REFUSED, f"{self._name}: {reason}")
        return HaltAnswer(robot=self._name, halted=False)

    def _answer_halts(self, now_ns: int) -> None:
        waiting, self._halts = self._halts, []
        for until_ns, reply in waiting:
            if self._robot.has_stopped or now_ns >= until_ns:
                unconfirmed = [] if self._robot.has_stopped else [VEHICLE]
                holders = self._robot.latch.holders
                reply(HaltAnswer(robot=self._name, halted=bool(holders), by=holders, not_halted=unconfirmed))
            else:
                self._halts.append((until_ns, reply))


def _plugins() -> list[PluginInfo]:
    """A behavior for each kind of task that a vehicle does."""
    schemas = {kind: parameters_schema(STOCK_KINDS[kind]) for kind in KINDS}
    kinds = [TaskKind(kind=kind, doc=STOCK_KINDS[kind].__doc__ or "", parameters=schemas[kind]) for kind in KINDS]
    return [PluginInfo(name=one.kind, level="behavior", state="active", task_kind=one) for one in kinds]


def vehicle_command(
    vehicle: Vehicle, name: str, broker: Broker, robot: VehicleRobot, connect: str | None, team: str
) -> None:
    """Run a vehicle as a robot until Ctrl-C; wait until the endpoints answer.

    Args:
        vehicle: its address on MQTT.
        name: of the robot.
        broker: of MQTT.
        robot: the vehicle as a robot.
        connect: endpoint of the team; None uses $ROBRAIN_CONNECT, else this machine's hub.
        team: its name.

    Raises:
        RobrainError: in one sentence.

    """
    should_stop, who = LiveStop(), f"vda5050 vehicle {name}"
    session = open_when_there(who, team_endpoints(connect), should_stop)
    if session is None:
        return
    member: VehicleMember | None = None
    with closing(session), claim_robot(session, team, name) as claim, live_endpoint(session, team) as wire:
        if not claim.acquire(lambda text: print_message(f"{who}: {text}"), should_stop):
            return
        will = ("instantActions", instant_action("cancelOrder", f"will-{wire.clock.now_ns()}"))
        delay_s = max(
            0, int(robot.continues_for_s - 1.5 * KEEPALIVE_S)
        )  # without a master, the broker cancels the order
        topics = ("connection", "state")
        with closing(MqttLink(vehicle, broker, f"robrain-{team}-{name}", topics, wire, will, delay_s)) as mqtt:
            should_stop.ready()
            print_result(f"{who}: master of {vehicle.manufacturer}/{vehicle.serial} at {broker.host}:{broker.port}")
            watch = NameWatcher(claim, should_stop)
            for _ in steps(watch, PERIOD_S):
                now_ns = wire.clock.now_ns()
                for message, _ in mqtt.receive():
                    robot.handle(message, now_ns)
                is_reachable = robot.is_online and mqtt.is_connected
                for topic, body in robot.step(now_ns) if is_reachable else ():
                    mqtt.publish(topic, body)
                is_present = is_reachable and robot.is_known
                if is_present and member is None:
                    member = VehicleMember(Endpoint(session, team, wire.clock, wire.drive), name, robot, wire.refusals)
                    print_result(f"{who}: up")
                elif not is_present and member is not None:
                    member.close()
                    member = None
                    print_result(f"{who}: the vehicle has disconnected")
                if member is not None:
                    member.step()
            if member is not None:
                member.close()
            watch.check()
