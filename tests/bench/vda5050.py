"""Orders by VDA 5050 both ways, with lost connections, broker restarts and killed processes.

python -m tests.bench.vda5050 [ORDERS] [VERSION]

Vehicles: tasks of a team become orders for simulated vehicles, which are written from the standard alone.
Fleet: a master, written from the standard alone, gives orders to robots of a team.
"""

import json
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

from robrain import TaskState, Team
from robrain.protocol.messages.tasks.task_messages import TaskFilter, TaskRecord

MOSQUITTO = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin")
ROBOTS, WINDOW, LIMIT_S = 4, 40, 3600.0
ROOT = Path(__file__).parents[2]


def say(line: str) -> None:
    """Print a line at once."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


class Outcome(NamedTuple):
    """Counts of a run."""

    done: int
    lost: int
    twice: int
    messages: int
    invalid: int
    disturbances: int
    took_s: float

    @property
    def is_good(self) -> bool:
        """Nothing was lost, nothing was done twice, and every message is valid."""
        return not (self.lost or self.twice or self.invalid)


class Stage:
    """Processes of a run: all end with the block.

    Args:
        folder: for their files.

    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._running: dict[str, tuple[list[str], subprocess.Popen[str], str]] = {}
        self.port = free_port()
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        (folder / "mosquitto.conf").write_text(f"listener {self.port} 127.0.0.1\nallow_anonymous true\n")

    def __enter__(self) -> "Stage":
        return self

    def __exit__(self, *_: object) -> None:
        for _, process, _ in reversed(self._running.values()):
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
        for _, process, _ in self._running.values():
            try:
                process.wait(20.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def start(self, name: str, words: list[str], text: str = "") -> None:
        """Start a process; its output is in NAME.log."""
        with (self.folder / f"{name}.log").open("a") as log:
            stdin = subprocess.PIPE if text else subprocess.DEVNULL
            process = subprocess.Popen(words, cwd=ROOT, stdin=stdin, stdout=log, stderr=log, text=True)
        if process.stdin is not None:
            process.stdin.write(text)
            process.stdin.close()
        self._running[name] = (words, process, text)

    def robrain(self, name: str, *words: str) -> None:
        """Start a command of robrain."""
        self.start(name, [sys.executable, "-m", "robrain.cli", *words])

    def kill(self, name: str) -> None:
        """Kill a process as `kill -9` does, and start it again."""
        words, process, text = self._running[name]
        process.kill()
        process.wait()
        self.start(name, words, text)

    def is_running(self, name: str) -> bool:
        """Whether a process has not ended."""
        return self._running[name][1].poll() is None

    def start_team(self) -> None:
        """Start broker, hub and coordinator."""
        assert MOSQUITTO is not None, "no mosquitto here: apt-get install mosquitto"
        self.start("broker", [MOSQUITTO, "-c", str(self.folder / "mosquitto.conf")])
        self.robrain("hub", "hub", "--listen", self.endpoint)
        self.robrain("coordinator", "coordinator", "--connect", self.endpoint, "--journal",
                     str(self.folder / "team.journal"))  # fmt: skip


def free_port() -> int:
    """A free port of this machine."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def await_robots(team: Team, count: int) -> None:
    """Wait until the robots are there."""
    until_s = time.monotonic() + 120.0
    while len(team.robots) < count:
        assert time.monotonic() < until_s, f"only {team.robots} are there"
        time.sleep(0.1)


def connected(stage: Stage) -> Team:
    """A client of the team, as soon as its hub answers."""
    until_s = time.monotonic() + 60.0
    while True:
        try:
            return Team.connect(stage.endpoint, patience_s=60.0)
        except Exception:  # noqa: BLE001 - the hub is starting
            assert time.monotonic() < until_s
            time.sleep(0.2)


def run_vehicles(orders: int, version: str, folder: Path, disturb_each: int) -> Outcome:
    """Have simulated vehicles do tasks of a team."""
    with Stage(folder) as stage:
        stage.start_team()
        log = folder / "vehicles.jsonl"
        words = [sys.executable, "-m", "tests.deploy.vda5050.vehicle_simulator", str(stage.port), version, str(ROBOTS)]
        stage.start("vehicles", [*words, str(log)])
        with connected(stage) as team:
            for number in range(ROBOTS):
                stage.robrain(f"vehicle{number}", "vda5050", "vehicle", f"acme/v{number}", "--name", f"v{number}",
                              "--broker", f"127.0.0.1:{stage.port}", "--version", version,
                              "--connect", stage.endpoint)  # fmt: skip
            await_robots(team, ROBOTS)
            began_s, disturbances = time.monotonic(), 0
            turns = [
                lambda: stage.kill("vehicle0"),
                lambda: stage.kill("broker"),
                lambda: log.with_suffix(".drop").touch(),
                lambda: stage.kill("coordinator"),
                lambda: stage.kill("vehicle1"),
            ]
            submitted = shown = 0
            while (done := Counter(record.state for record in listed(team, orders))[TaskState.DONE]) < orders:
                assert time.monotonic() - began_s < LIMIT_S, f"only {done} of {orders} were done in time"
                while submitted < min(orders, done + WINDOW):
                    place = (1.0 + 1.7 * (submitted % 5), 1.0 + 1.3 * (submitted % 7))
                    team.submit("visit", id=f"t{submitted}", place=place)
                    submitted += 1
                if done >= disturb_each * (disturbances + 1):
                    turns[disturbances % len(turns)]()
                    disturbances += 1
                if done >= shown + max(1, orders // 20):
                    shown = done
                    say(f"vehicles: {done} of {orders} done, {time.monotonic() - began_s:.0f} s")
                time.sleep(0.1)
            took_s = time.monotonic() - began_s
        events = [json.loads(line) for line in log.read_text().splitlines()]
    times = Counter(event["order"].split(":")[1] for event in events if event["event"] == "completed")
    messages = [event for event in events if event["event"] == "message"]
    invalid = [event["wrong"] for event in messages if event["wrong"]]
    for wrong in invalid[:5]:
        say(f"vehicles: invalid: {wrong}")
    lost = sum(f"t{number}" not in times for number in range(orders))
    twice = {task: count for task, count in times.items() if count > 1}
    if twice:
        say(f"vehicles: done twice: {twice}")
    return Outcome(done, lost, len(twice), len(messages), len(invalid), disturbances, took_s)


def listed(team: Team, limit: int) -> list[TaskRecord]:
    """All tasks of the team."""
    return team.list(TaskFilter(limit=limit + WINDOW))


def start_robots(stage: Stage, names: list[str], version: str) -> None:
    """Start robots, and the gateway that shows them as vehicles."""
    wire = subprocess.run([sys.executable, "-m", "robrain.cli", "wire", "--format", "jsonschema"],
                          capture_output=True, text=True, check=True, cwd=ROOT).stdout  # fmt: skip
    robot = str(ROOT / "tests" / "deploy" / "vda5050" / "fast_robot.py")
    for number, name in enumerate(names):
        log = str(stage.folder / "robots.log")
        stage.start(name, [sys.executable, robot, stage.endpoint, name, log, str(1.0 + number)], wire)
    stage.robrain("fleet", "vda5050", "fleet", "--broker", f"127.0.0.1:{stage.port}", "--version", version,
                  "--connect", stage.endpoint, "--orders", str(stage.folder / "orders"))  # fmt: skip


def run_fleet(orders: int, version: str, folder: Path, disturb_each: int) -> Outcome:
    """Have a master give orders to robots of a team."""
    with Stage(folder) as stage:
        stage.start_team()
        done_log = folder / "robots.log"
        names = [f"p{number}" for number in range(ROBOTS)]
        with connected(stage) as team:
            start_robots(stage, names, version)
            await_robots(team, ROBOTS)
            began_s, disturbances, shown = time.monotonic(), 0, 0
            words = [sys.executable, "-m", "tests.deploy.vda5050.master", str(stage.port), version, str(orders)]
            stage.start("master", [*words, *names])
            turns = [lambda: stage.kill("fleet"), lambda: stage.kill("broker"), lambda: stage.kill("coordinator")]
            while stage.is_running("master"):
                assert time.monotonic() - began_s < LIMIT_S, "the master has not ended in time"
                lines = [line for line in (folder / "master.log").read_text().splitlines() if line.startswith("done ")]
                done = int(lines[-1].split()[1]) if lines else 0
                if done >= disturb_each * (disturbances + 1):
                    turns[disturbances % len(turns)]()
                    disturbances += 1
                if done >= shown + max(1, orders // 20):
                    shown = done
                    say(f"fleet: {done} of {orders} done, {time.monotonic() - began_s:.0f} s")
                time.sleep(0.1)
            took_s = time.monotonic() - began_s
            records = listed(team, 3 * orders)
        summary = json.loads((folder / "master.log").read_text().splitlines()[-1])
    for wrong in summary["mistakes"][:5]:
        say(f"fleet: invalid: {wrong}")
    say(f"fleet: messages {summary['kinds']}")
    times = Counter(line.split()[1] for line in done_log.read_text().splitlines())
    twice = {task: count for task, count in times.items() if count > 1}
    lost = orders - summary["done"] + sum(record.state is not TaskState.DONE for record in records)
    lost += abs(2 * orders - len(records))
    if twice:
        say(f"fleet: done twice: {twice}")
    return Outcome(summary["done"], lost, len(twice), summary["messages"], summary["invalid"], disturbances, took_s)


def main() -> int:
    """Run both ways; exit status 1 if anything was lost, done twice or invalid."""
    orders = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    versions = sys.argv[2:3] or ["2.1.0", "3.0.0"]
    is_good = True
    with ExitStack() as stack:
        for version in versions:
            for name, run in (("vehicles", run_vehicles), ("fleet", run_fleet)):
                folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
                outcome = run(orders, version, folder, max(5, orders // 20))
                is_good &= outcome.is_good
                say(f"{name} {version}: {outcome.done} of {orders} orders done in {outcome.took_s:.0f} s, "
                      f"{outcome.disturbances} disturbances; lost {outcome.lost}, done twice {outcome.twice}; "
                      f"{outcome.messages} messages, {outcome.invalid} invalid")  # fmt: skip
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main())
