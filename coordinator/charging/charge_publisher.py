"""Publishes which robots charge where and when, and which tasks wait for a charge."""

from robrain.coordinator.charging.charge_schedule import Seeker, Turn
from robrain.coordinator.planning.planning import Planning
from robrain.coordinator.tasks.task_book import TaskBook
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.wire.clock import to_ns, to_seconds
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.messages.tasks.plan_messages import ChargeSchedule, PlannedCharge
from robrain.protocol.wire.reasons.plans import WaitsForCharger
from robrain.protocol.wire.reasons.tasks import WaitsForCharge
from robrain.protocol.wire.reasons.words import told
from robrain.protocol.wire.topics import COORDINATOR_CHARGES

MOVED_NS, MOVED_SHARE = to_ns(10.0), 0.1
"""The schedule is published again when the end of a charge has moved by more than both (the share is of the time until
then), or when anything else has changed (chosen)."""

MOVED_SOC = 0.1
"""It is told again what level a task waits for when that has moved by more (chosen)."""


class ChargePublisher:
    """Publishes the schedule of charges.

    Args:
        wire: the coordinator's Zenoh endpoint.
        planning: receives the schedule too, to answer queries.
        book: of the tasks.

    """

    def __init__(self, wire: Endpoint, planning: Planning, book: TaskBook) -> None:
        self._say = wire.publisher(COORDINATOR_CHARGES)
        self._planning = planning
        self._book = book
        self._said: tuple[PlannedCharge, ...] = ()

    def schedule(
        self, turns: tuple[Turn, ...], seekers: dict[str, Seeker], has_set_out: set[str], now_ns: int
    ) -> dict[str, WaitsForCharger | None]:
        """Publish the schedule if it has changed; returns why each robot that has not set out waits, if known."""
        charges = tuple(_planned(turn, seekers[turn.robot], turn.robot in has_set_out, now_ns) for turn in turns)
        self._planning.charges = charges
        if not _is_the_same(self._said, charges, now_ns):
            self._said = charges
            self._say.put(ChargeSchedule(charges=charges))
        return {one.robot: one.reason for one in charges if not one.has_set_out}

    def tasks(self, now_ns: int) -> None:
        """Publish for each queued task that it waits for its robot to charge, and when this ends."""
        for record in self._book.open:
            if record.own or record.state is not TaskState.QUEUED:
                continue
            robot = self._planning.waits_for_charge(record.task.id)
            said = record.reason if isinstance(record.reason, WaitsForCharge) else None
            after = self._planning.after_charge.get(robot)
            if after is not None and (said is None or said.robot != robot or abs(said.to_soc - after.soc) > MOVED_SOC):
                in_s = max(0.0, to_seconds(after.free_ns - now_ns))
                self._book.move(record.task.id, TaskState.QUEUED, WaitsForCharge(robot, after.soc, round(in_s, 3)))
            elif not robot and said is not None and record.task.id not in self._planning.left_out:
                self._book.move(record.task.id, TaskState.QUEUED)


def _planned(turn: Turn, one: Seeker, has_set_out: bool, now_ns: int) -> PlannedCharge:
    reason = None
    if turn.behind and not one.is_there:
        reason = WaitsForCharger(turn.charger, round(turn.free_s, 3), turn.behind)
    return PlannedCharge(
        robot=turn.robot,
        charger=turn.charger,
        set_out_ns=now_ns + (0 if has_set_out else to_ns(turn.set_out_s)),
        from_ns=now_ns + to_ns(turn.from_s),
        until_ns=now_ns + to_ns(turn.until_s),
        soc=round(one.soc, 3),
        to_soc=round(turn.to_soc, 3),
        behind=turn.behind,
        has_set_out=has_set_out,
        is_there=one.is_there,
        why=told(reason),
        reason=reason,
    )


def _is_the_same(said: tuple[PlannedCharge, ...], now: tuple[PlannedCharge, ...], now_ns: int) -> bool:
    """Whether the published schedule still holds, apart from the passing of time."""
    if len(said) != len(now):
        return False
    for one, other in zip(said, now, strict=True):
        if (one.robot, one.charger, one.behind) != (other.robot, other.charger, other.behind):
            return False
        if (one.has_set_out, one.is_there) != (other.has_set_out, other.is_there):
            return False
        if abs(one.until_ns - other.until_ns) > max(MOVED_NS, MOVED_SHARE * (one.until_ns - now_ns)):
            return False
    return True
