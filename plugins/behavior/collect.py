"""Collect: a data mule. Goes near a mote, asks for what it has stored, and stays until that has come or time is up."""

from robrain.plugins.behavior.errand import Errand, Failed, Script
from robrain.plugins.skill.energy.interface import Work
from robrain.plugins.unit.snw_exploration.interface import HeardMote, SnwInterface
from robrain.protocol.clock import to_ns
from robrain.protocol.model.tasks.stock_kinds import COLLECT, Collect
from robrain.protocol.model.tasks.task import Task

LOOK_S = 0.6
"""How often it is looked whether more has come."""
ASK_AGAIN_S = 8.0
"""A request may be lost, and a mote sends so many readings at the most for one."""
PACKETS = 64
"""That much radio is reckoned with."""


class CollectBehavior(Errand[Collect]):
    """Fetches the readings that a mote has stored."""

    kind = COLLECT

    def activate(self) -> None:
        self._snw = self.env.use("snw_exploration", SnwInterface)
        super().activate()

    def work(self, task: Task, collect: Collect) -> Work:
        """All of the time that it may take."""
        return Work(wait_s=collect.timeout_s, radio_packets=PACKETS)

    def do(self, task: Task, collect: Collect) -> Script:
        """Ask and wait. Result: `readings` that came, and how many are still `missing`."""
        before = self._heard(collect.mote)
        had = before.readings if before is not None else 0
        begun_ns = self.env.clock.now_ns()
        until_ns = begun_ns + to_ns(collect.timeout_s)
        ask_ns = 0
        while (now_ns := self.env.clock.now_ns()) < until_ns:
            if now_ns >= ask_ns:
                self._snw.request_stored(collect.mote)
                ask_ns = now_ns + to_ns(ASK_AGAIN_S)
            yield from self.wait(LOOK_S)
            mote = self._heard(collect.mote)
            # It must have been heard here: what it had said before tells nothing of what it has stored since.
            if mote is not None and mote.missing == 0 and mote.stamp_ns > begun_ns:
                return {"readings": mote.readings - had, "missing": 0}  # 0: others have brought in all there is
        mote = self._heard(collect.mote)
        if mote is None or mote.readings == had:
            raise Failed(f"nothing came from {collect.mote} in {collect.timeout_s:g} s")
        return {"readings": mote.readings - had, "missing": mote.missing}

    def _heard(self, mote: str) -> HeardMote | None:
        return next((heard for heard in self._snw.heard() if heard.mote == mote), None)
