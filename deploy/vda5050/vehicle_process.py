"""`robrain vda5050 vehicle`: a vehicle of another vendor is a robot of the team; this process is its master.

Tasks become orders. The id of an order names the task and its epoch, and its last node the time to stay there. So the
vehicle's state alone tells a restarted process what the vehicle does for the team.
"""

import hashlib
import re
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing, suppress
from itertools import pairwise
from typing import Any

import msgspec

from robrain.deploy.command_line.output import print_message, print_result
from robrain.deploy.processes.live_process import LiveStop, SendTimes, wire_when_there
from robrain.deploy.processes.name_claim import NameWatcher, claim_robot
from robrain.deploy.vda5050 import messages as vda
from robrain.deploy.vda5050.mqtt_link import KEEPALIVE_S, PERIOD_S, Broker, MqttLink
from robrain.protocol.clock import steps, to_ns
from robrain.protocol.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots import host_messages, robot_messages
from robrain.protocol.messages.robots.plugin_messages import ROBOT_PLUGINS, PluginInfo, TaskKind
from robrain.protocol.messages.robots.robot_messages import PlannedPath, PluginFault, RobotState, TaskStatus
from robrain.protocol.messages.tasks import offer_messages
from robrain.protocol.messages.tasks.offer_messages import TaskAnswer, TaskOffer, TaskWithdrawal
from robrain.protocol.messages.team import team_messages, zone_messages
from robrain.protocol.messages.team.team_messages import Halt, HaltStatus, TeamState
from robrain.protocol.model.geometry import Point2D, Twist2D
from robrain.protocol.model.ranges import cut
from robrain.protocol.model.tasks.halt_latch import HaltLatch
from robrain.protocol.model.tasks.stock_kinds import PATROL, STOCK_KINDS, VISIT, Patrol
from robrain.protocol.model.tasks.task import Task, TaskState, parameters_of
from robrain.protocol.model.zone import Zone, ZoneKind
from robrain.protocol.reasons import OfferRefusal, RobotHalted, plain
from robrain.protocol.refusals import Refusals, most_refused
from robrain.protocol.schema.struct_schema import parameters_schema
from robrain.protocol.wire.endpoint import Deferred, Endpoint, Request, Serve

STATE_NS = to_ns(0.1)
HALT_NS = to_ns(2.0)
"""Time for a vehicle to confirm a halt."""
ASK_TIMEOUT_S = 2.0
KINDS = (VISIT, PATROL)
AGAIN_NS = to_ns(1.0)
"""Messages that the vehicle's state does not confirm are repeated after this time: they are sent with QoS 0."""
SETTLE_NS = to_ns(2.0)
"""An order that was sent may still arrive within this time (chosen)."""
GIVE_UP_NS = to_ns(10.0)
"""An order that the vehicle does not accept within this time has failed (chosen)."""
RESUME_NS = to_ns(5.0)
"""A vehicle that is still paused this long after a resume was paused by somebody else (chosen)."""
START_DEVIATION_M = 0.5
VEHICLE = "vehicle"
"""Holder of a halt that is the vehicle's own pause; operators end it, or the vehicle."""
ORDER_ID = re.compile(r"robrain:([A-Za-z0-9_.\-]+):([0-9]+)")
DRIVES = ("AUTOMATIC", "SEMIAUTOMATIC")
STOPS = ("CRITICAL", "FATAL")
"""Levels of errors with which a vehicle cannot continue its order."""


UNKNOWN = vda.State("", "", [], [], driving=False, operating_mode="STARTUP", action_states=[], errors=[])
"""The state of a vehicle that has not sent one."""
Outgoing = tuple[str, Any]
"""A topic of the vehicle, and the message without its header."""


class _Work(msgspec.Struct):
    """A task that the robot has accepted and not ended."""

    status: TaskStatus
    lease_ns: int
    order: vda.VehicleOrder | None = None
    """None after a restart: the vehicle has it."""
    cancelled: str = ""
    """Why it is cancelled once the vehicle has no order for it; empty if it is not to be cancelled."""
    sent_ns: int | None = None
    arrived_ns: int | None = None


class VehicleRobot:
    """Follows docs/reference/robot-contract.md for a vehicle.

    Args:
        name: of the robot.
        vehicle: its address. Without a map's id, the map that it reports.
        radius_m: of its footprint.
        continues_for_s: time for which the vehicle keeps its order without this process or the coordinator.

    """

    def __init__(self, name: str, vehicle: vda.Vehicle, radius_m: float, continues_for_s: float) -> None:
        self.zones: Sequence[Zone] | None = None
        """Zones of the team; None until they are known."""
        self.latch = HaltLatch()
        self.name, self.address, self._radius_m = name, vehicle, radius_m
        self.continues_for_s = continues_for_s
        self.is_online = False
        """Whether the vehicle is connected to the broker."""
        self.is_known = False
        """Whether the vehicle has sent its state."""
        self._vehicle = UNKNOWN
        self._work: _Work | None = None
        self._ended: TaskStatus | None = None
        self._received_ns = 0
        self._team_halt_ns = 0
        """Stamp of the last halt or resume of the team."""
        self._resumed_ns = -RESUME_NS
        self._times = SendTimes()
        self._sent = ("", -SETTLE_NS)
        """Id of the order that was sent last, and when."""

    def handle(self, message: object, now_ns: int) -> None:
        """Process a message of the vehicle or the team; the first state tells which task the vehicle does."""
        match message:
            case vda.VehicleConnection():
                self.is_online = message.connection_state == "ONLINE"
            case vda.State():
                is_first, self._vehicle, self.is_known = not self.is_known, message, True
                if is_first and (held := _read_order_id(message.order_id)) is not None:
                    self._received_ns = now_ns
                    self._begin(*held, self.continues_for_s)
            case zone_messages.Zones():
                self.zones = message.zones
            case Halt(by=by, stamp_ns=stamp_ns):
                self._team_halt_ns = max(self._team_halt_ns, stamp_ns)
                if message.halted:
                    self.halt(by, message.reason, stamp_ns)
                else:
                    self.resume(by, now_ns, stamp_ns)
            case HaltStatus(halted=True) if message.stamp_ns > self.latch.stamp_ns:  # newer than all received
                for by in message.by:
                    self.handle(Halt(halted=True, by=by, reason=message.reason, stamp_ns=message.stamp_ns), now_ns)
            case TeamState():
                self.handle(message.halt, now_ns)
                ages_s = [one.age_s for one in message.robots if one.name == self.name and one.up]
                self._received_ns = max([self._received_ns, *(now_ns - to_ns(age_s) for age_s in ages_s)])

    def step(self, now_ns: int) -> list[Outgoing]:
        """Messages to send to the vehicle now."""
        vehicle, work = self._vehicle, self._work
        if not self.is_known:
            return self._instant("stateRequest", now_ns)
        if work is not None and now_ns - self._received_ns > work.lease_ns:
            self._cancel("the coordinator is silent, the lease ran out")
        sent = [*self._pause(vehicle, now_ns), *self._send_zones(vehicle, now_ns)]
        held, is_wanted = _read_order_id(vehicle.order_id), False
        if work is not None and self._has_order(work, held):
            self._check_progress(work, vehicle, now_ns)
            is_wanted = self._work is work and not work.cancelled
        elif work is not None:
            sent += self._send_order(work, vehicle, now_ns)
        if held is not None and not vehicle.is_idle and not is_wanted:
            sent += self._instant("cancelOrder", now_ns)
        return sent

    def _has_order(self, work: _Work, held: tuple[str, int] | None) -> bool:
        """Whether the vehicle has the task's order, or does or has completed one of an earlier epoch."""
        if held is None or held[0] != work.status.id:
            return False
        is_earlier = not self._vehicle.is_idle or _stay_ns(self._vehicle) is not None
        return is_earlier or work.order is None or work.order.order_id == self._vehicle.order_id

    def _check_progress(self, work: _Work, vehicle: vda.State, now_ns: int) -> None:
        faults, stay_ns = _faults(vehicle), _stay_ns(vehicle)
        if not vehicle.is_idle:
            if faults:
                self._finish(TaskState.FAILED, faults)
        elif stay_ns is None:
            self._finish(TaskState.CANCELLED, work.cancelled or f"the vehicle has dropped the order: {faults}")
        else:
            work.arrived_ns = work.arrived_ns or now_ns
            if now_ns >= work.arrived_ns + stay_ns:
                self._finish(TaskState.DONE, "")
            elif work.cancelled:
                self._finish(TaskState.CANCELLED, work.cancelled)

    def _send_order(self, work: _Work, vehicle: vda.State, now_ns: int) -> list[Outgoing]:
        order = work.order
        order_id = order.order_id if order is not None else ""
        cause = vda.Reference("orderId", order_id)
        other_may_arrive = self._sent[0] not in (order_id, vehicle.order_id) and now_ns - self._sent[1] < SETTLE_NS
        refused = [one.words for one in vehicle.errors if cause in (one.error_references or ())]
        if work.cancelled:
            if work.sent_ns is None or now_ns - self._sent[1] > SETTLE_NS:
                self._finish(TaskState.CANCELLED, work.cancelled)
        elif order is None or (not vehicle.is_idle and _read_order_id(vehicle.order_id) is None):
            self._finish(TaskState.CANCELLED, f"the vehicle has the order {vehicle.order_id} of another master")
        elif refused or (work.sent_ns is not None and now_ns - work.sent_ns > GIVE_UP_NS):
            why = "; ".join(refused or [error.words for error in vehicle.errors]) or "no reason given"
            self._finish(TaskState.FAILED, f"the vehicle does not accept the order: {why}")
        elif vehicle.is_idle and not other_may_arrive and (work.sent_ns is None or now_ns - self._sent[1] >= AGAIN_NS):
            work.sent_ns = work.sent_ns or now_ns
            self._sent = (order_id, now_ns)
            return [("order", order)]
        return []

    def _pause(self, vehicle: vda.State, now_ns: int) -> list[Outgoing]:
        is_ours = any(holder != VEHICLE for holder in self.latch.holders)
        if not vehicle.paused:
            self.latch.release(VEHICLE)
            return self._instant("startPause", now_ns) if is_ours else []
        if not is_ours and now_ns - self._resumed_ns < RESUME_NS:
            return self._instant("stopPause", now_ns)
        if not self.latch.is_held:
            self.latch.hold(VEHICLE, "the vehicle is paused")
        return []

    def _send_zones(self, vehicle: vda.State, now_ns: int) -> list[Outgoing]:
        if self.zones is None or vehicle.zone_sets is msgspec.UNSET:  # version 2 has none
            return []
        map_id = self.address.map_id or (vehicle.position.map_id if vehicle.position else "")
        content = zone_set_of(self.zones, self.name, self.address._replace(map_id=map_id))
        there = {one.zone_set_id: one.zone_set_status for one in vehicle.zone_sets or ()}
        name = content["zoneSetId"]
        if name not in there:
            is_due = (content["zones"] or there) and self._times.is_due("zoneSet", AGAIN_NS, now_ns)
            return [("zoneSet", {"zoneSet": content})] if is_due else []
        return [] if there[name] == "ENABLED" else self._instant("enableZoneSet", now_ns, zoneSetId=name)

    def _instant(self, kind: str, now_ns: int, **parameters: str) -> list[Outgoing]:
        message = instant_action(kind, f"{kind}-{now_ns}", **parameters)
        return [("instantActions", message)] if self._times.is_due(kind, AGAIN_NS, now_ns) else []

    def offer(self, offer: TaskOffer, now_ns: int) -> TaskAnswer:
        """Accept a task, or refuse it with a reason."""
        task, epoch, status = offer.task, offer.epoch, self._status
        if (outdated := self._outdated(epoch)) is not None:
            return outdated
        if status is not None and (status.id, status.epoch) == (task.id, epoch):
            return TaskAnswer(accepted=True)
        refusal = self._refusal(offer)
        if refusal is not None:
            return TaskAnswer.refused(refusal)
        if self._work is not None:
            self._finish(TaskState.CANCELLED, f"replaced by {task.id}")
        self._received_ns = now_ns
        self._begin(task.id, epoch, max(offer.lease_s, self.continues_for_s), self._order(task, epoch))
        return TaskAnswer(accepted=True)

    def withdraw(self, withdrawal: TaskWithdrawal) -> TaskAnswer:
        """End a task: its status stays `running` until the vehicle has no order for it."""
        if (outdated := self._outdated(withdrawal.epoch)) is not None:
            return outdated
        if self._work is not None and self._work.status.id == withdrawal.id:
            self._cancel(withdrawal.why or "withdrawn")
        return TaskAnswer(accepted=True)

    def halt(self, by: str, reason: str, stamp_ns: int = 0) -> None:
        """Pause the vehicle, and end its task."""
        self.latch.hold(by, reason, stamp_ns)
        self._cancel("the robot is halted")

    def resume(self, by: str, now_ns: int, stamp_ns: int = 0) -> str:
        """End a halt; returns why the vehicle stays paused, empty if it does not."""
        reason = self.latch.release(by, stamp_ns)
        if not self.latch.is_held:
            self._resumed_ns = now_ns
        return reason

    @property
    def not_halted(self) -> list[str]:
        """The vehicle, until it confirms that it is paused and stands."""
        return [] if self._vehicle.paused and not self._vehicle.driving else [VEHICLE]

    @property
    def path(self) -> list[Point2D]:
        """The path ahead: the one that the vehicle reports, else straight lines; empty when it has no order."""
        vehicle, order = self._vehicle, self._work.order if self._work is not None else None
        if vehicle.position is None or not vehicle.node_states:
            return []
        found: list[vda.Waypoint] = [vehicle.position]
        if vehicle.intermediate_path:
            found = [*vehicle.intermediate_path.polyline]
        elif order is not None:
            ahead = {one.sequence_id for one in vehicle.node_states}
            found += [node.node_position for node in order.nodes if node.node_position and node.sequence_id in ahead]
        return [self.address.place(point) for point in found]

    def robot_state(self) -> RobotState:
        """The vehicle as a robot; its state must be known."""
        vehicle, is_halted = self._vehicle, self.latch.is_held
        at, faults, moving = vehicle.position, _faults(vehicle), vehicle.velocity or vda.Velocity()
        lost = "" if at is not None else "the vehicle does not know its position"
        if at is not None and self.address.map_id not in ("", at.map_id):
            lost, at = f"expected map {self.address.map_id}, got {at.map_id}", None
        return RobotState(
            robot=self.name,
            pose=None if at is None else self.address.to_arena(at.x, at.y, at.theta),
            velocity=Twist2D(moving.vx, moving.vy, moving.omega),
            radius_m=self._radius_m,
            battery=vehicle.battery,
            behavior=VEHICLE if self._work is not None else "",
            task=self._status,
            task_before=self._ended,
            halted=is_halted,
            halted_by=self.latch.holders,
            team_halt_ns=self._team_halt_ns if is_halted else 0,
            not_halted=self.not_halted if is_halted else [],
            faulted=[PluginFault(plugin=VEHICLE, why=faults)] if faults else [],
            lost=lost,
            continues_for_s=self.continues_for_s,
        )

    def _refusal(self, offer: TaskOffer) -> OfferRefusal | None:
        vehicle, faults = self._vehicle, _faults(self._vehicle)
        try:
            _places(offer.task)
        except ValueError as error:
            return plain("vehicle_cannot", str(error))
        if self.latch.is_held:
            return RobotHalted()
        if offer.after:
            return plain("vehicle_holds_none", "the vehicle holds no second task")
        if vehicle.operating_mode not in DRIVES:
            return plain("vehicle_mode", f"operating mode {vehicle.operating_mode}")
        if faults:
            return plain("vehicle_faulted", faults)
        return None if vehicle.position else plain("vehicle_unready", "the vehicle does not know its position")

    @property
    def _status(self) -> TaskStatus | None:
        return self._ended if self._work is None else self._work.status

    def _outdated(self, epoch: int) -> TaskAnswer | None:
        """The answer to a message of an old epoch; None if the epoch is not old."""
        newest = self._status.epoch if self._status is not None else 0
        return TaskAnswer(accepted=False, why=f"epoch {newest} is newer", epoch=newest) if epoch < newest else None

    def _begin(self, task_id: str, epoch: int, lease_s: float, order: vda.VehicleOrder | None = None) -> None:
        self._work = _Work(TaskStatus(id=task_id, epoch=epoch, state=TaskState.RUNNING), to_ns(lease_s), order)

    def _cancel(self, why: str) -> None:
        if self._work is not None:
            self._work.cancelled = self._work.cancelled or why

    def _finish(self, state: TaskState, why: str) -> None:
        assert self._work is not None
        self._ended = msgspec.structs.replace(self._work.status, state=state, why=cut(why))
        self._work = None

    def _order(self, task: Task, epoch: int) -> vda.VehicleOrder:
        order_id, places, start = f"robrain:{task.id}:{epoch}", _places(task), self._vehicle.position
        assert start is not None
        ellipse = {"a": START_DEVIATION_M, "b": START_DEVIATION_M, "theta": 0.0}
        allowed = START_DEVIATION_M if self.address.version is vda.Version.V2_1 else ellipse
        at_start = vda.NodePosition(start.x, start.y, start.map_id, allowed_deviation=allowed)
        on_map = (self.address.waypoint(place.x_m, place.y_m) for place in places)
        stops = [at_start, *(vda.NodePosition(at.x, at.y, start.map_id) for at in on_map)]
        ids = [*(f"node-{number}" for number in range(len(places))), f"{order_id}:{to_ns(task.service_s)}"]
        nodes = [vda.OrderNode(2 * n, True, [], one, at) for n, (one, at) in enumerate(zip(ids, stops, strict=True))]
        edges = [vda.OrderEdge(2 * n + 1, True, [], f"edge-{n}", *ends) for n, ends in enumerate(pairwise(ids))]
        return vda.VehicleOrder(order_id, 0, nodes, edges)


def instant_action(kind: str, action_id: str, **parameters: str) -> vda.InstantActions:
    """A message with an instant action; both versions accept the blocking type NONE."""
    found = [vda.ActionParameter(key, value) for key, value in parameters.items()]
    return vda.InstantActions([vda.OrderAction(kind, action_id, "NONE", found)])


def _places(task: Task) -> list[Point2D]:
    """Places of a task in turn (ValueError if a vehicle cannot do it)."""
    if task.kind == VISIT:
        return [task.place]
    if task.kind != PATROL:
        raise ValueError(f"a vehicle does no task to {task.kind}")
    patrol = parameters_of(task, Patrol)
    if patrol.pause_s:
        raise ValueError("a vehicle makes no pauses in a patrol: expected pause_s 0")
    if patrol.rounds * (len(patrol.stops) + 1) + 2 > vda.NODES_MAX:
        raise ValueError(f"expected a patrol of fewer than {vda.NODES_MAX} nodes")
    return [task.place, *patrol.stops] * patrol.rounds + [task.place]


def _read_order_id(order_id: str) -> tuple[str, int] | None:
    """Task and epoch of an order; None if it is of another master."""
    found = ORDER_ID.fullmatch(order_id)
    return (found[1], int(found[2])) if found else None


def _stay_ns(vehicle: vda.State) -> int | None:
    """Time to stay at the last node of the order, once the vehicle has reached it; None before."""
    order_id, _, stay_ns = vehicle.last_node_id.rpartition(":")
    return int(stay_ns) if order_id == vehicle.order_id and stay_ns.isdecimal() else None


def _faults(vehicle: vda.State) -> str:
    """Errors with which the vehicle cannot continue its order, in words."""
    return "; ".join(error.words for error in vehicle.errors if error.error_level in STOPS)


ZONE_TYPES = {ZoneKind.SPEED_LIMIT: "SPEED_LIMIT", ZoneKind.PENALTY: "PENALTY"}
"""Zone types of version 3 beside `BLOCKED`; zones of other kinds are not sent."""


def zone_set_of(zones: Sequence[Zone], robot: str, vehicle: vda.Vehicle) -> dict[str, Any]:
    """The zones that a robot has to obey as a zone set, whose id changes with its content."""
    found = []
    for zone in zones:
        zone_type = "BLOCKED" if zone.keeps_out else ZONE_TYPES.get(zone.kind)
        if zone_type is None or not zone.binds(robot):
            continue
        vertices = [vehicle.waypoint(x_m, y_m) for x_m, y_m in zone.corners_m]
        limit = {"maximumSpeed": zone.speed_m_s} if zone_type == "SPEED_LIMIT" else {}
        if zone_type == "PENALTY" and zone.cost_m is not None:
            limit = {"penaltyFactor": zone.cost_m / (1.0 + zone.cost_m)}
        found.append({"zoneId": zone.name, "zoneType": zone_type, "vertices": vertices, **limit})
    digest = hashlib.sha256(msgspec.json.encode([vehicle.map_id, found])).hexdigest()
    return {"mapId": vehicle.map_id, "zoneSetId": f"robrain-{digest[:16]}", "zones": found}


class VehicleMember:
    """The vehicle's membership of the team: it begins with the token, and ends with `close`.

    Args:
        wire: closed with the membership.
        robot: the vehicle.
        refusals: counts of the vehicle's messages.

    """

    def __init__(self, wire: Endpoint, robot: VehicleRobot, refusals: Refusals) -> None:
        self._wire, self._robot, self._refusals, name = wire, robot, refusals, robot.name
        self._inbox = Inbox()
        self._halts: list[tuple[int, Callable[[host_messages.HaltAnswer | CallError], None]]] = []
        self._times = SendTimes()
        self._last: object = None
        self._path: list[Point2D] = []
        self._states = wire.publisher(robot_messages.ROBOT_STATE, robot=name)
        self._paths = wire.publisher(robot_messages.ROBOT_PATH, robot=name)
        now_ns, in_step = wire.clock.now_ns, Serve.IN_STEP
        wire.answer(ROBOT_PLUGINS, lambda _: _plugins(), robot=name)
        wire.answer(offer_messages.ROBOT_OFFER, lambda one: robot.offer(one.asked, now_ns()), serve=in_step, robot=name)
        wire.answer(offer_messages.ROBOT_WITHDRAW, lambda one: robot.withdraw(one.asked), serve=in_step, robot=name)
        wire.answer(host_messages.HOST_HALT, self._halt, serve=in_step, robot=name)
        wire.answer(host_messages.HOST_RESUME, self._resume, serve=in_step, robot=name)
        for topic in (team_messages.HALT, team_messages.COORDINATOR_STATE, zone_messages.COORDINATOR_ZONES):
            wire.subscribe(self._inbox, topic)
        with suppress(NobodyThere, CallError):  # there is no coordinator
            robot.handle(wire.ask(team_messages.COORDINATOR_HALT, timeout_s=ASK_TIMEOUT_S), now_ns())
        wire.token(robot_messages.ROBOT_ALIVE, robot=name)

    def step(self) -> None:
        """Answer requests, process messages and publish the vehicle's state."""
        now_ns = self._wire.clock.now_ns()
        for received in self._inbox.drain():
            self._robot.handle(received.message, now_ns)
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
        if self._times.is_due("state", STATE_NS if news == self._last else 0, now_ns):
            self._states.put(state)
            self._last = news
        path = self._robot.path
        if bool(path) != bool(self._path) or path[1:] != self._path[1:]:
            self._paths.put(PlannedPath(robot=self._robot.name, points=path))
        self._path = path

    def _halt(self, request: Request[host_messages.HaltRequest]) -> Deferred[host_messages.HaltAnswer]:
        self._robot.halt(request.by or request.asked.by, request.asked.reason)
        until_ns = self._wire.clock.now_ns() + HALT_NS
        return Deferred(lambda reply: self._halts.append((until_ns, reply)))

    def _resume(self, request: Request[host_messages.ResumeRequest]) -> host_messages.HaltAnswer:
        reason = self._robot.resume(request.by or request.asked.by, self._wire.clock.now_ns())
        if reason:
            raise CallError(ErrorCode.REFUSED, f"{self._robot.name}: {reason}")
        return host_messages.HaltAnswer(robot=self._robot.name, halted=False)

    def _answer_halts(self, now_ns: int) -> None:
        not_halted, by = self._robot.not_halted, self._robot.latch.holders
        for waiting in [one for one in self._halts if not not_halted or now_ns >= one[0]]:
            self._halts.remove(waiting)
            waiting[1](host_messages.HaltAnswer(robot=self._robot.name, halted=bool(by), by=by, not_halted=not_halted))


def _plugins() -> list[PluginInfo]:
    """A behavior for each kind of task that a vehicle does."""
    schemas = {kind: parameters_schema(STOCK_KINDS[kind]) for kind in KINDS}
    kinds = [TaskKind(kind=kind, doc=STOCK_KINDS[kind].__doc__ or "", parameters=schemas[kind]) for kind in KINDS]
    return [PluginInfo(name=one.kind, level="behavior", state="active", task_kind=one) for one in kinds]


def vehicle_command(robot: VehicleRobot, broker: Broker, connect: str | None, team: str) -> None:
    """Run a vehicle as a robot until Ctrl-C; wait until the endpoints answer.

    Args:
        robot: the vehicle as a robot.
        broker: of MQTT.
        connect: endpoint of the team; None uses $ROBRAIN_CONNECT, else this machine's hub.
        team: its name.

    Raises:
        RobrainError: in one sentence.

    """
    should_stop, who, address = LiveStop(), f"vda5050 vehicle {robot.name}", robot.address
    member: VehicleMember | None = None
    with ExitStack() as stack:
        wire = stack.enter_context(wire_when_there(who, connect, team, should_stop))
        if wire is None:
            return
        claim = stack.enter_context(claim_robot(wire.session, team, robot.name))
        if not claim.acquire(lambda text: print_message(f"{who}: {text}"), should_stop):
            return
        # Without a master, the broker cancels the order.
        delay_s = max(0, int(robot.continues_for_s - 1.5 * KEEPALIVE_S))
        will = "instantActions", instant_action("cancelOrder", f"will-{wire.clock.now_ns()}"), delay_s
        link = MqttLink(address, broker, f"robrain-{team}-{robot.name}", ("connection", "state"), wire, will)
        mqtt = stack.enter_context(closing(link))
        should_stop.ready()
        print_result(f"{who}: master of {address.manufacturer}/{address.serial} at {broker.host}:{broker.port}")
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
                member = VehicleMember(Endpoint(wire.session, team, wire.clock, wire.drive), robot, wire.refusals)
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
