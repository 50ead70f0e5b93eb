"""A run of points with two coordinators, each on its own machine, and robots as their witnesses."""

import numpy as np

from robrain.coordinator.coordinator import Coordinator
from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.coordinator.leadership.candidate import Candidate
from robrain.coordinator.leadership.election import Elected, Election
from robrain.coordinator.leadership.leadership import ElectedLeadership
from robrain.lab.soak.fault_script import FaultScript
from robrain.lab.soak.operator import OPERATOR
from robrain.lab.soak.soak_run import SoakRun
from robrain.protocol.refusals import Refusals
from robrain.sim.faults.fault_spec import COORDINATOR, FaultKind, FaultSpec
from robrain.sim.faults.process import JournalDisk, Process

OTHER = "stand_by"
SITES = (COORDINATOR, OTHER)
LAST_S = 60.0


class Site:
    """One machine with a coordinator: stands by, leads, and stands by again once another one leads."""

    def __init__(self, run: "ElectedRun", process: Process, disk: JournalDisk) -> None:
        self._run, self._process = run, process
        self._journal = disk.open()
        self.coordinator: Coordinator | None = None
        self.took_over = 0
        self._begin()

    def step(self) -> None:
        """Take the step of the part that it plays."""
        if self.coordinator is not None:
            self.coordinator.step()
            if self.coordinator.part(ElectedLeadership).mandate.superseded:
                self.coordinator.close()
                self._wire.close()
                self.coordinator = None
                self._begin()
            return
        self.candidate.step()
        if self.candidate.elected is not None:
            self._lead(self.candidate.elected)

    def close(self) -> None:
        """End it."""
        if self.coordinator is not None:
            self.coordinator.close()

    @property
    def refusals(self) -> Refusals:
        return self._wire.refusals

    def _lead(self, elected: Elected) -> None:
        self._wire.close()
        self._wire = self._run.wire_of(self._process)
        try:
            self._journal.own()
            self.coordinator = Coordinator(self._wire, self._journal, self._run._planning, elected=elected)
            self._run.elections.append(elected.won.election)
        except JournalUnwritable:  # its disk is full: as in live, it stands for election again
            self._wire.close()
            self._begin()

    def leads(self) -> bool:
        """Whether it would offer tasks now."""
        now_ns = self._process.clock.now_ns()
        return self.coordinator is not None and self.coordinator.part(ElectedLeadership).mandate.leads(now_ns)

    def _begin(self) -> None:
        self._wire = self._run.wire_of(self._process)
        election = Election(self._wire, self._run.witnesses, self._journal.name)
        self.candidate = Candidate(self._wire, self._journal, self._process.name, election)


class ElectedRun(SoakRun):
    """Robots remember over restarts what they have answered; both coordinators have disks of their own."""

    def __init__(self, script: FaultScript, faults: tuple[FaultSpec, ...]) -> None:
        self.witnesses = [robot.name for robot in script.robots]
        self.elections: list[int] = []
        self.disks = {name: JournalDisk(name) for name in SITES}
        super().__init__(script, faults)
        self.team_faults.disk = self.disks[COORDINATOR]
        self.team_faults.add(OTHER, lambda process: Site(self, process, self.disks[OTHER]), self._end_other)

    def site(self, name: str) -> Site | None:
        found = self.processes[name].component
        return found if isinstance(found, Site) else None

    @property
    def leader(self) -> Coordinator | None:
        """The one that leads; None if none does."""
        for name in self.leading():
            return self.site(name).coordinator
        return None

    def leading(self) -> list[str]:
        """Who would offer tasks now."""
        return [
            name
            for name in SITES
            if (site := self.site(name)) is not None and self.processes[name].is_awake and site.leads()
        ]

    def tick(self) -> None:
        super().tick()
        self.processes[OTHER].step(self.clock.now_ns())

    def _start_coordinator(self, process: Process) -> Site:
        self._coordinator_wire = self.wire_of(process)
        return Site(self, process, self.disks[COORDINATOR])

    def _end_other(self, _site: Site) -> None:
        self.disks[OTHER].pull()

    def _end_coordinator(self, coordinator: Site) -> None:
        """As a process that is killed, it says nothing."""
        self.team_faults.disk.pull()


def faults_of_sites(seed: int, robots: list[str]) -> tuple[FaultSpec, ...]:
    """Kills, hangs and cuts of either machine."""
    rng = np.random.default_rng([seed, 77])
    found = []
    for _ in range(int(rng.integers(1, 5))):
        at_s = round(float(rng.uniform(3.0, LAST_S)), 1)
        until_s = round(at_s + float(rng.uniform(0.5, 20.0)), 1)
        kind = FaultKind(str(rng.choice([FaultKind.KILL, FaultKind.HANG, FaultKind.PARTITION])))
        site, other = (SITES, SITES[::-1])[int(rng.integers(2))]
        side = ()
        if kind is FaultKind.PARTITION:
            with_it = [name for name in (*robots, other, OPERATOR) if rng.random() < 0.4]
            side = tuple(sorted(with_it))
        found.append(FaultSpec(robot=site, kind=kind, at_s=at_s, until_s=until_s, side=side))
    return tuple(found)
