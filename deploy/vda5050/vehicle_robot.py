"""A vehicle as a robot of a team: tasks become orders. Pure: neither MQTT nor Zenoh, and the time is passed in.

The id of an order names the task and its epoch, and its last node the time to stay there. So the vehicle's state alone
tells a restarted process what the vehicle does for the team.
"""

import hashlib
import re
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import msgspec

from robrain.deploy.vda5050 import messages as vda
from robrain.deploy.vda5050.messages import NODES_MAX, State, Vehicle, VehicleOrder
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.robots.robot_messages import PluginFault, RobotState, TaskStatus
from robrain.protocol.messages.tasks.offer_messages import TaskAnswer, TaskOffer, TaskWithdrawal
from robrain.protocol.model.geometry import Point2D, Twist2D
from robrain.protocol.model.ranges import cut
from robrain.protocol.model.tasks.halt_latch import HaltLatch
from robrain.protocol.model.tasks.stock_kinds import PATROL, VISIT, Patrol
from robrain.protocol.model.tasks.task import BadParameters, Task, TaskState, parameters_of
from robrain.protocol.model.zone import Zone, ZoneKind
from robrain.protocol.reasons import OfferRefusal, RobotHalted, plain

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
STAY = re.compile(r"[0-9]{1,15}")
DRIVES = ("AUTOMATIC", "SEMIAUTOMATIC")
STOPS = ("CRITICAL", "FATAL")
"""Levels of errors with which a vehicle cannot continue its order."""


UNKNOWN = State("", 0, "", 0, [], [], driving=False, operating_mode="STARTUP", action_states=[], errors=[])
"""The state of a vehicle that has not sent one."""
Outgoing = tuple[str, Any]
"""A topic of the vehicle, and the message without its header."""


class _Work(msgspec.Struct):
    """A task that the robot has accepted and not ended."""

    status: TaskStatus
    lease_ns: int
    order: VehicleOrder | None = None
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

    def __init__(self, name: str, vehicle: Vehicle, radius_m: float, continues_for_s: float) -> None:
        self.zones: Sequence[Zone] | None = None
        """Zones of the team; None until they are known."""
        self.latch = HaltLatch()
        self.team_halt_ns = 0
        """Stamp of the last halt or resume of the team."""
        self._name, self._place, self._radius_m = name, vehicle, radius_m
        self.continues_for_s = continues_for_s
        self.is_online = False
        """Whether the vehicle is connected to the broker."""
        self._vehicle = UNKNOWN
        self._work: _Work | None = None
        self._ended: TaskStatus | None = None
        self._epoch = 0
        self._received_ns = 0
        self._resumed_ns = -RESUME_NS
        self._times = vda.SendTimes()
        self._sent = ("", -SETTLE_NS)
        """Id of the order that was sent last, and when."""

    # -- the vehicle's side -----------------------------------------------------------------------------------------

    @property
    def is_known(self) -> bool:
        """Whether the vehicle has sent its state."""
        return self._vehicle is not UNKNOWN

    def handle(self, message: object, now_ns: int) -> None:
        """Process a message; the first state tells which task the vehicle does."""
        match message:
            case vda.VehicleConnection(connection_state=connection):
                self.is_online = connection == "ONLINE"
            case State() as state:
                is_first, self._vehicle = not self.is_known, state
                if is_first and (held := _read_order_id(state.order_id)) is not None:
                    self._received_ns = now_ns
                    self._begin(*held, self.continues_for_s)

    def step(self, now_ns: int) -> list[Outgoing]:
        """Messages to send to the vehicle now."""
        vehicle, work = self._vehicle, self._work
        if not self.is_known:
            return self._instant("stateRequest", now_ns)
        if work is not None and now_ns - self._received_ns > work.lease_ns:
            self._cancel("the coordinator is silent, the lease ran out")
        sent = [*self._pause(vehicle, now_ns), *self._send_zones(vehicle, now_ns)]
        held = _read_order_id(vehicle.order_id)
        if work is not None and self._is_order_of(work, vehicle, held):
            self._check_progress(work, vehicle, now_ns)
        elif work is not None:
            sent += self._send_order(work, vehicle, now_ns)
        work = self._work
        is_wanted = work is not None and not work.cancelled and self._is_order_of(work, vehicle, held)
        if held is not None and not vehicle.is_idle and not is_wanted:
            sent += self._instant("cancelOrder", now_ns)
        return sent

    def _is_order_of(self, work: _Work, vehicle: State, held: tuple[str, int] | None) -> bool:
        """Whether the vehicle has the task's order, or does or has completed one of an earlier epoch."""
        if held is None or held[0] != work.status.id:
            return False
        is_earlier = not vehicle.is_idle or _stay_ns(vehicle) is not None
        return is_earlier or work.order is None or work.order.order_id == vehicle.order_id

    def _check_progress(self, work: _Work, vehicle: State, now_ns: int) -> None:
        faults = _faults(vehicle)
        stay_ns = _stay_ns(vehicle)
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

    def _send_order(self, work: _Work, vehicle: State, now_ns: int) -> list[Outgoing]:
        order = work.order
        refused = [
            one.words for one in vehicle.errors if order is not None and one.refers_to("orderId", order.order_id)
        ]
        if work.cancelled:
            if work.sent_ns is None or now_ns - self._sent[1] > SETTLE_NS:
                self._finish(TaskState.CANCELLED, work.cancelled)
        elif order is None or (not vehicle.is_idle and _read_order_id(vehicle.order_id) is None):
            self._finish(TaskState.CANCELLED, f"the vehicle has the order {vehicle.order_id} of another master")
        elif refused or (work.sent_ns is not None and now_ns - work.sent_ns > GIVE_UP_NS):
            why = "; ".join(refused or [error.words for error in vehicle.errors]) or "no reason given"
            self._finish(TaskState.FAILED, f"the vehicle does not accept the order: {why}")
        elif self._sent[0] not in (order.order_id, vehicle.order_id) and now_ns - self._sent[1] < SETTLE_NS:
            pass  # the order before may still arrive
        elif vehicle.is_idle and (work.sent_ns is None or now_ns - self._sent[1] >= AGAIN_NS):
            work.sent_ns = work.sent_ns or now_ns
            self._sent = (order.order_id, now_ns)
            return [("order", order)]
        return []

    def _pause(self, vehicle: State, now_ns: int) -> list[Outgoing]:
        is_ours = any(holder != VEHICLE for holder in self.latch.holders)
        if not vehicle.paused:
            if VEHICLE in self.latch.holders:
                self.latch.release(VEHICLE)
            return self._instant("startPause", now_ns) if is_ours else []
        if is_ours:
            return []
        if now_ns - self._resumed_ns < RESUME_NS:
            return self._instant("stopPause", now_ns)
        if VEHICLE not in self.latch.holders:
            self.latch.hold(VEHICLE, "the vehicle is paused")
        return []

    def _send_zones(self, vehicle: State, now_ns: int) -> list[Outgoing]:
        if self.zones is None or vehicle.zone_sets is msgspec.UNSET:  # version 2 has none
            return []
        content = zone_set_of(self.zones, self._name, self._mapped)
        there = {one.zone_set_id: one.zone_set_status for one in vehicle.zone_sets or ()}
        name = content["zoneSetId"]
        if name not in there:
            is_due = (content["zones"] or there) and self._times.is_due("zoneSet", AGAIN_NS, now_ns)
            return [("zoneSet", {"zoneSet": content})] if is_due else []
        return [] if there[name] == "ENABLED" else self._instant("enableZoneSet", now_ns, zoneSetId=name)

    def _instant(self, kind: str, now_ns: int, **parameters: str) -> list[Outgoing]:
        if not self._times.is_due(kind, AGAIN_NS, now_ns):
            return []
        return [("instantActions", instant_action(kind, f"{kind}-{now_ns}", **parameters))]

    # -- the team's side --------------------------------------------------------------------------------------------

    def offer(self, offer: TaskOffer, now_ns: int) -> TaskAnswer:
        """Accept a task, or refuse it with a reason."""
        task, epoch = offer.task, offer.epoch
        if epoch < self._epoch:
            return self._newer
        if self._status is not None and (self._status.id, self._status.epoch) == (task.id, epoch):
            return TaskAnswer(accepted=True)
        try:
            places = _places(task)
        except (BadParameters, ValueError) as error:
            return TaskAnswer.refused(plain("vehicle_cannot", str(error)))
        at, refusal = self._vehicle.position, self._refusal(offer)
        if refusal is not None or at is None:
            return TaskAnswer.refused(refusal or plain("vehicle_unready", "the vehicle does not know its position"))
        if self._work is not None:
            self._finish(TaskState.CANCELLED, f"replaced by {task.id}")
        self._received_ns = now_ns
        lease_s = max(offer.lease_s, self.continues_for_s)
        self._begin(task.id, epoch, lease_s, self._order(task, epoch, places, at))
        return TaskAnswer(accepted=True)

    def withdraw(self, withdrawal: TaskWithdrawal) -> TaskAnswer:
        """End a task: its status stays `running` until the vehicle has no order for it."""
        if withdrawal.epoch < self._epoch:
            return self._newer
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

    def renew_lease(self, received_ns: int) -> None:
        """The coordinator has received this robot's state at that time."""
        self._received_ns = max(self._received_ns, received_ns)

    @property
    def has_stopped(self) -> bool:
        """Whether the vehicle confirms that it is paused and stands."""
        return bool(self._vehicle.paused) and not self._vehicle.driving

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
        return [self._place.place(point) for point in found]

    def robot_state(self) -> RobotState:
        """The vehicle as a robot; its state must be known."""
        vehicle, is_halted = self._vehicle, self.latch.is_held
        at, faults, moving = vehicle.position, _faults(vehicle), vehicle.velocity or vda.Velocity()
        lost = "" if at is not None else "the vehicle does not know its position"
        if at is not None and self._place.map_id not in ("", at.map_id):
            lost = f"expected map {self._place.map_id}, got {at.map_id}"
            at = None
        return RobotState(
            robot=self._name,
            pose=None if at is None else self._place.to_arena(at.x, at.y, at.theta),
            velocity=Twist2D(moving.vx, moving.vy, moving.omega),
            radius_m=self._radius_m,
            battery=vehicle.battery,
            behavior=VEHICLE if self._work is not None else "",
            task=self._status,
            task_before=self._ended,
            halted=is_halted,
            halted_by=self.latch.holders,
            team_halt_ns=self.team_halt_ns if is_halted else 0,
            not_halted=[VEHICLE] if is_halted and not self.has_stopped else [],
            faulted=[PluginFault(plugin=VEHICLE, why=faults)] if faults else [],
            lost=lost,
            continues_for_s=self.continues_for_s,
        )

    @property
    def _mapped(self) -> Vehicle:
        at = self._vehicle.position
        return self._place if self._place.map_id or at is None else self._place._replace(map_id=at.map_id)

    def _refusal(self, offer: TaskOffer) -> OfferRefusal | None:
        vehicle = self._vehicle
        if self.latch.is_held:
            return RobotHalted()
        if offer.after:
            return plain("vehicle_holds_none", "the vehicle holds no second task")
        if vehicle.operating_mode not in DRIVES:
            return plain("vehicle_mode", f"operating mode {vehicle.operating_mode}")
        faults = _faults(vehicle)
        return plain("vehicle_faulted", faults) if faults else None

    @property
    def _status(self) -> TaskStatus | None:
        return self._ended if self._work is None else self._work.status

    @property
    def _newer(self) -> TaskAnswer:
        return TaskAnswer(accepted=False, why=f"epoch {self._epoch} is newer", epoch=self._epoch)

    def _begin(self, task_id: str, epoch: int, lease_s: float, order: VehicleOrder | None = None) -> None:
        self._epoch = epoch
        self._work = _Work(TaskStatus(id=task_id, epoch=epoch, state=TaskState.RUNNING), to_ns(lease_s), order)

    def _cancel(self, why: str) -> None:
        if self._work is not None:
            self._work.cancelled = self._work.cancelled or why

    def _finish(self, state: TaskState, why: str) -> None:
        assert self._work is not None
        self._ended = msgspec.structs.replace(self._work.status, state=state, why=cut(why))
        self._work = None

    def _order(self, task: Task, epoch: int, places: Sequence[Point2D], start: vda.Position) -> VehicleOrder:
        order_id, around = f"robrain:{task.id}:{epoch}", START_DEVIATION_M
        allowed: vda.Deviation = (
            around if self._place.version is vda.Version.V2_1 else {"a": around, "b": around, "theta": 0.0}
        )
        at_start = vda.NodePosition(start.x, start.y, start.map_id, allowed_deviation=allowed)
        on_map = (self._place.waypoint(place.x_m, place.y_m) for place in places)
        positions = [at_start, *(vda.NodePosition(at.x, at.y, start.map_id) for at in on_map)]
        names = [*(f"node-{number}" for number in range(len(places))), f"{order_id}:{to_ns(task.service_s)}"]
        nodes = [
            vda.OrderNode(name, 2 * number, True, [], position)
            for number, (name, position) in enumerate(zip(names, positions, strict=True))
        ]
        edges = [
            vda.OrderEdge(f"edge-{number}", 2 * number + 1, True, [], before, after)
            for number, (before, after) in enumerate(pairwise(names))
        ]
        return VehicleOrder(order_id, 0, nodes, edges)


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
    if patrol.rounds * (len(patrol.stops) + 1) + 2 > NODES_MAX:
        raise ValueError(f"expected a patrol of fewer than {NODES_MAX} nodes")
    return [task.place, *patrol.stops] * patrol.rounds + [task.place]


def _read_order_id(order_id: str) -> tuple[str, int] | None:
    """Task and epoch of an order; None if it is of another master."""
    found = ORDER_ID.fullmatch(order_id)
    return (found[1], int(found[2])) if found else None


def _stay_ns(vehicle: State) -> int | None:
    """Time to stay at the last node of the order, once the vehicle has reached it; None before."""
    order_id, _, stay_ns = vehicle.last_node_id.rpartition(":")
    return int(stay_ns) if order_id == vehicle.order_id and STAY.fullmatch(stay_ns) else None


def _faults(vehicle: State) -> str:
    """Errors with which the vehicle cannot continue its order, in words."""
    return "; ".join(error.words for error in vehicle.errors if error.error_level in STOPS)


# -- zones ------------------------------------------------------------------------------------------------------------

ZONE_TYPES = {ZoneKind.SPEED_LIMIT: "SPEED_LIMIT", ZoneKind.PENALTY: "PENALTY"}
"""Zone types of version 3 beside `BLOCKED`; zones of other kinds are not sent."""


def zone_set_of(zones: Sequence[Zone], robot: str, vehicle: Vehicle) -> dict[str, Any]:
    """The zones that a robot has to obey as a zone set, whose id changes with its content."""
    found = []
    for zone in zones:
        zone_type = "BLOCKED" if zone.keeps_out else ZONE_TYPES.get(zone.kind)
        if zone_type is None or not zone.binds(robot):
            continue
        vertices = [vehicle.waypoint(x_m, y_m) for x_m, y_m in zone.corners_m]
        content: dict[str, Any] = {"zoneId": zone.name, "zoneType": zone_type, "vertices": vertices}
        if zone_type == "SPEED_LIMIT":
            content["maximumSpeed"] = zone.speed_m_s
        if zone_type == "PENALTY" and zone.cost_m is not None:
            content["penaltyFactor"] = zone.cost_m / (1.0 + zone.cost_m)
        found.append(content)
    digest = hashlib.sha256(msgspec.json.encode([vehicle.map_id, found])).hexdigest()
    return {"mapId": vehicle.map_id, "zoneSetId": f"robrain-{digest[:16]}", "zones": found}
