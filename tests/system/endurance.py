"""A live team with tasks for a long time: do memory, descriptors and threads of its processes stay as they are?

`python -m tests.system.endurance --minutes 30` is what `make endurance` runs: `robrain up` with eight robots, a
recorder and a page, a seeded flow of tasks, reloads of plugins, faults of hardware that pass, and a halt of the team
now and then. Every five seconds it notes what each process takes; `endurance.csv` has all of it.
"""

import argparse
import csv
import json
import random
import statistics
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import psutil

from robrain import Scenario, Team
from robrain.client.submission import BadTask
from robrain.protocol.errors import CallError, NobodyThere, RobrainError
from robrain.protocol.messages.tasks.task_messages import TaskFilter
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import TaskState
from robrain.sim.faults.fault_spec import FaultKind, FaultSpec
from tests.system.soak import Process

SCENARIO = "depot"
RECORDING, JOURNAL = "endurance.mcap", "team.journal"
SAMPLE_S = 5.0
TASK_S = 4.0
"""A task is submitted this often, if no more than `OPEN_TASKS` are open."""
OPEN_TASKS = 12
RELOAD_S = 20.0
"""A plugin of some robot is reloaded this often, and each `UNLOAD` th time unloaded with its users and loaded again."""
UNLOAD = 4
RELOADED = ("mocdevice", "scan", "driver", "localisation", "mapper", "planner", "energy", "explore", "visit")
HALT_S, HALTED_S = 120.0, 5.0
"""The team is halted this often, for so long."""
FAULT_S, FAULTY_S = 60.0, 2.0
"""The hardware of some robot fails this often, for so long."""
FAULTS = (
    FaultKind.CAN_CUT, FaultKind.CAN_SHORTED, FaultKind.MOTORS_FAIL, FaultKind.LIDAR_FREEZES,
    FaultKind.BATTERY_LIES, FaultKind.MOTE_BASE_FLOODS,
)  # fmt: skip
END_S = 180.0
"""The last tasks have so long to end."""
SETTLED_SHARE = 1 / 3
"""Share of the run after which a process should have all that it needs: maps are drawn, caches are full."""
GROWTH_MB_H = 40.0
"""Growth of resident memory after that, MiB an hour (chosen: a robot with 1 GB lasts for a day)."""
LEAST_GROWTH_MB = 4.0
"""Less is not judged: memory comes in pages and arenas."""
SPREAD = 3
"""Descriptors and threads may be this many more at the end than after settling: connections of clients come and go."""


class Sample(NamedTuple):
    """What a process took at a time."""

    time_s: float
    pid: int
    name: str
    memory_mb: float
    """Resident, MiB."""
    descriptors: int
    threads: int
    cpu_s: float
    """Since it began."""


class Endured(NamedTuple):
    """What became of a run."""

    samples: list[Sample]
    submitted: list[str]
    ended: Mapping[str, str]
    """Final state of each task that was acknowledged."""
    halts: int


def sample_of(process: psutil.Process, name: str, time_s: float) -> Sample:
    """What a process takes now (NoSuchProcess if it has ended)."""
    resident_mb, cpu = process.memory_info().rss / 1048576.0, process.cpu_times()
    figures = (round(resident_mb, 2), process.num_fds(), process.num_threads(), cpu.user + cpu.system)
    return Sample(round(time_s, 1), process.pid, name, *figures)


def family_of(parent: int) -> list[tuple[psutil.Process, str]]:
    """A process and those that it has started, each with a name that says what it is."""
    up = psutil.Process(parent)
    found = [(up, "up")]
    for child in up.children():
        with suppress(psutil.NoSuchProcess):
            words = child.cmdline()
            robot = next((Path(word).stem for word in words if word.endswith(".toml") and "agent" in words), "")
            kinds = ("arena", "coordinator", "dashboard", "record", "hub", "router")
            if name := robot or next((kind for kind in kinds if kind in words), ""):
                found.append((child, name))
    return found


def endure(folder: Path, minutes: float, *, robots: int, seed: int, scenario: str = SCENARIO) -> Endured:
    """Run a team for so long; it is gone afterwards."""
    for old in ("up.log", RECORDING, JOURNAL):
        (folder / old).unlink(missing_ok=True)
    draw = random.Random(seed)
    samples: list[Sample] = []
    submitted: list[str] = []
    halts = 0
    (folder / "faulty.toml").write_text(_with_faults(Scenario.builtin(scenario), minutes, robots, draw).to_toml())
    up = Process(
        folder, "up", "up", "faulty.toml", "--robots", str(robots), "--seed", str(seed), "--port", "0",
        "--record", RECORDING, "--journal", JOURNAL, "--listen", "tcp/127.0.0.1:0",
    )  # fmt: skip
    try:
        hub = up.wait_for(r"hub: (\S+)")[1]
        for part in ("dashboard: ", *(rf"r{number}: up" for number in range(1, robots + 1))):
            up.wait_for(part)
        with Team.connect(hub, by="operator:endurance", patience_s=60.0) as team:
            began_s = time.monotonic()
            due_s = {"sample": 0.0, "task": 3.0, "halt": HALT_S, "reload": RELOAD_S}
            reloads = 0
            while (now_s := time.monotonic() - began_s) < 60.0 * minutes:
                if now_s >= due_s["sample"]:
                    due_s["sample"] = now_s + SAMPLE_S
                    for process, name in family_of(up.process.pid):
                        with suppress(psutil.NoSuchProcess):
                            samples.append(sample_of(process, name, now_s))
                if now_s >= due_s["task"]:
                    due_s["task"] = now_s + TASK_S
                    _submit(team, draw, submitted)
                if now_s >= due_s["reload"]:
                    due_s["reload"] = now_s + RELOAD_S
                    reloads += 1
                    _reload(team, draw, unload=reloads % UNLOAD == 0)
                if now_s >= due_s["halt"]:
                    due_s["halt"] = now_s + HALT_S
                    halts += 1
                    team.halt()
                    time.sleep(HALTED_S)
                    team.resume()
                time.sleep(0.1)
            ended = _wait_for_ends(team, submitted)
    finally:
        up.stop()
    return Endured(samples, submitted, ended, halts)


def _with_faults(scenario: Scenario, minutes: float, robots: int, draw: random.Random) -> Scenario:
    """The scenario, with faults that pass."""
    faults = []
    for at_s in range(int(FAULT_S), int(60.0 * minutes), int(FAULT_S)):
        robot, kind = f"r{draw.randint(1, robots)}", draw.choice(FAULTS)
        faults.append(FaultSpec(robot=robot, kind=kind, at_s=float(at_s), until_s=at_s + FAULTY_S))
    return scenario.replace(faults=tuple(faults))


def _reload(team: Team, draw: random.Random, *, unload: bool) -> None:
    """Reload a plugin of some robot, or take it away for a moment from those that require it."""
    robot, plugin = draw.choice(team.robots), draw.choice(RELOADED)
    with suppress(CallError, NobodyThere):  # it may be out, or another reload may be under way
        if not unload:
            team.reload(robot, plugin)
            return
        gone = [info.name for info in team.unload(robot, plugin, cascade=True)]
        for name in reversed(gone):
            team.load(robot, name)


def _submit(team: Team, draw: random.Random, submitted: list[str]) -> None:
    """A visit to where some robot has been: a place that is known, and that robots can get to."""
    with suppress(CallError, NobodyThere, BadTask):
        still_open = TaskFilter(states=[state for state in TaskState if not state.ended])
        if len(team.list(still_open)) >= OPEN_TASKS or not team.robots:
            return
        state = team.state(draw.choice(team.robots))
        pose = state.pose
        if pose is None or state.lost:  # its pose may be one on a map of its own
            return
        name = f"e{len(submitted) + 1}"
        team.submit("visit", id=name, place=Point2D(round(pose.x_m, 2), round(pose.y_m, 2)), service_s=2.0)
        submitted.append(name)


def _wait_for_ends(team: Team, submitted: Sequence[str]) -> dict[str, str]:
    ends_s = time.monotonic() + END_S
    states: dict[str, str] = {}
    while time.monotonic() < ends_s:
        with suppress(RobrainError):
            states = {name: str(team.get(name).state) for name in submitted}
            if all(TaskState(state).ended for state in states.values()):
                break
        time.sleep(1.0)
    return states


def verdict(endured: Endured) -> list[str]:
    """What is not as it should be, in sentences; empty if all is."""
    wrong = []
    for name, own in by_process(endured.samples).items():
        if len({sample.pid for sample in own}) > 1:
            wrong.append(f"{name}: was started again")
            continue
        settled = own[int(len(own) * SETTLED_SHARE) :]
        if len(settled) < 6:
            wrong.append(f"{name}: {len(own)} samples are too few")
            continue
        third = len(settled) // 3
        early, late = settled[:third], settled[-third:]
        grown_mb = statistics.median(one.memory_mb for one in late) - statistics.median(one.memory_mb for one in early)
        hours = (statistics.mean(one.time_s for one in late) - statistics.mean(one.time_s for one in early)) / 3600.0
        if grown_mb > max(LEAST_GROWTH_MB, GROWTH_MB_H * hours):
            wrong.append(f"{name}: memory grew by {grown_mb:.1f} MiB in {60 * hours:.0f} min")
        for what in ("descriptors", "threads"):
            before, after = (statistics.median(getattr(one, what) for one in part) for part in (early, late))
            if after > before + SPREAD:
                wrong.append(f"{name}: {what} grew from {before:g} to {after:g}")
    lost = [name for name in endured.submitted if not TaskState(endured.ended.get(name, "queued")).ended]
    if lost:
        wrong.append(f"{len(lost)} of {len(endured.submitted)} tasks have not ended: {', '.join(lost[:5])}")
    return wrong


def by_process(samples: Sequence[Sample]) -> dict[str, list[Sample]]:
    """Samples by name of the process, in order of time."""
    found: dict[str, list[Sample]] = {}
    for sample in samples:
        found.setdefault(sample.name, []).append(sample)
    return {name: found[name] for name in sorted(found, key=lambda name: (len(name), name))}


def write_csv(samples: Sequence[Sample], path: Path) -> None:
    """One line for each sample."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(Sample._fields)
        writer.writerows(samples)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--robots", type=int, default=8)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--folder", type=Path, default=Path("runs/endurance"))
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    endured = endure(given.folder.resolve(), given.minutes, robots=given.robots, seed=given.seed)
    write_csv(endured.samples, given.folder / "endurance.csv")
    wrong = verdict(endured)
    memory_mb = {
        name: [own[place].memory_mb for place in (0, len(own) // 3, -1)]
        for name, own in by_process(endured.samples).items()
    }
    said = {
        "minutes": given.minutes, "robots": given.robots, "tasks": len(endured.submitted), "halts": endured.halts,
        "done": sum(state == "done" for state in endured.ended.values()), "memory_mb": memory_mb, "wrong": wrong,
    }  # fmt: skip
    sys.stdout.write(json.dumps(said, indent=1) + "\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
