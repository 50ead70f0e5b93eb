"""Point recharge: a stand-in robot goes to a charger, when told and by itself when it must."""

from typing import ClassVar

from robrain.protocol.model.energy_model import Work
from robrain.protocol.model.tasks.stock_kinds import RECHARGE, Recharge
from robrain.protocol.model.tasks.task import Task, TaskState, parameters_of
from robrain.protocol.reasons import OfferRefusal
from robrain.sim.stand_in.plugins.point_errand import PointErrand, home_j

GUARD_S = 0.5
UNTIL_SOC = 0.95
MARGIN_J = 100.0
"""Beyond the reserve, with which tasks are taken on."""


class PointRecharge(PointErrand):
    """Goes to a charger and stays until the battery is full enough."""

    kind = RECHARGE
    task_parameters = Recharge
    idle_period_s: ClassVar[float | None] = GUARD_S

    def init(self) -> None:
        super().init()
        self._is_own = False
        self._count = 0

    def work(self, task: Task) -> Work:
        """What is used at the charger comes from the charger."""
        return Work()

    def why_not(self, task: Task) -> OfferRefusal | None:
        """To run out of energy on the way to a charger is no worse than to wait for it."""
        return None

    def accept_task(self, task: Task) -> None:
        super().accept_task(task)
        self._is_own = False

    def step(self) -> None:
        if self.task is None or not self._is_own:
            self._guard()
        task = self.task
        if task is not None and self._is_own and not self.env.tasks.occupies(self.env.plugin):
            self.drop()
        super().step()

    def may_drive(self, task: Task) -> bool:
        """Also when it charges by itself."""
        return self._is_own or super().may_drive(task)

    def is_done(self, task: Task, served_s: float) -> bool:
        """Full enough."""
        return self.base.soc() >= parameters_of(task, Recharge).until_soc

    def finish(self, task: Task) -> None:
        is_own = self._is_own
        self.drop()
        self.base.stand()
        if is_own:
            self.env.tasks.vacate(self.env.plugin)
        else:
            self.env.tasks.end(task.id, TaskState.DONE, result={"soc": round(self.base.soc(), 3)})

    def drop(self) -> None:
        super().drop()
        self._is_own = False

    def emergency_halt(self) -> None:
        super().emergency_halt()
        self._is_own = False

    def _guard(self) -> None:
        """Go home if the battery gives little more than the way home takes."""
        place, charger = self.base.place(), self.base.nearest_charger()
        if charger is None or self.task is not None or self.base.soc() <= 0.0:
            return
        if self.base.energy_j() > home_j(place, charger) - MARGIN_J:
            return
        tasks = self.env.tasks
        if tasks.is_busy:
            tasks.recall("the way home needs what is left of the battery")
            return
        if tasks.occupy(self.env.plugin, firm="it goes home to charge"):
            self._count += 1
            name = f"home-{self.env.robot}-{self._count}"
            wanted = Recharge(until_soc=UNTIL_SOC)
            self.accept_task(Task(id=name, kind=RECHARGE, place=charger, parameters=wanted.json))
            self._is_own = True
