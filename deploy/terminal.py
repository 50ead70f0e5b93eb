"""What a person sees in the terminal: progress, summaries, tables. Everything goes to stderr; stdout is for results."""

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console, Group
from rich.live import Live
from rich.markup import escape
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn
from rich.table import Table
from rich.text import Text

from robrain.deploy.forwarders import said
from robrain.deploy.team_found import TeamFound
from robrain.deploy.up import TeamStatus, UpResult
from robrain.protocol.wire.safe_text import safe_text
from robrain.sim.result import RunResult
from robrain.sim.scenario import Progress as RunProgress

console = Console(stderr=True, highlight=False)


class _ClockColumn(ProgressColumn):
    """Simulated time and speed."""

    def render(self, task: Task) -> Text:
        """One cell of the bar's line."""
        sim_time_s = task.fields.get("sim_time_s", 0.0)
        speed = task.fields.get("speed", 0.0)
        return Text(f"{_clock(sim_time_s)} simulated  {speed:5.1f} × real time", style="dim")


class RunDisplay:
    """The progress bar of one run."""

    def __init__(self, progress: Progress, until_explored: float) -> None:
        self._progress = progress
        self._bar = progress.add_task("explored", total=until_explored, sim_time_s=0.0, speed=0.0)
        self._last: RunProgress | None = None
        self._speed = 0.0

    def show(self, now: RunProgress) -> None:
        """Draw how far the run has come; the speed is that of the last second or so."""
        if self._last is None:
            self._last = now
        elapsed_s = now.wall_time_s - self._last.wall_time_s
        if elapsed_s > 0.5:
            self._speed = (now.sim_time_s - self._last.sim_time_s) / elapsed_s
            self._last = now
        self._progress.update(self._bar, completed=now.explored_fraction, sim_time_s=now.sim_time_s, speed=self._speed)


@contextmanager
def run_display(until_explored: float, *, quiet: bool = False) -> Iterator[RunDisplay]:
    """A progress bar for as long as the block lasts; it leaves nothing on a stream that is no terminal."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=30),
        TextColumn("{task.completed:6.1%}"),
        _ClockColumn(),
    )
    with Progress(*columns, console=console, disable=quiet or not console.is_terminal) as progress:
        yield RunDisplay(progress, until_explored)


class UpDisplay:
    """Who of a team is up: a table that is drawn anew in a terminal, a line for each change elsewhere."""

    def __init__(self, live: Live | None, *, quiet: bool) -> None:
        self._live = live
        self._quiet = quiet
        self._before: dict[str, str] = {}

    def ready(self, endpoint: str, url: str | None) -> None:
        """All processes are started."""
        if not self._quiet:
            say(f"hub: {endpoint}  (other commands: --connect {endpoint})")
            if url is not None:
                say(f"dashboard: {url}")

    def show(self, status: TeamStatus) -> None:
        """Draw how the team is."""
        if self._live is not None:
            self._live.update(_team_table(status))
        elif not self._quiet:
            now = dict(status.robots) | {"coordinator": "up" if status.coordinator_up else "starting"}
            for name, text in now.items():
                seen = "up" if text not in ("starting", "halted") and "lost" not in text and text != "gone" else text
                if self._before.get(name) != seen:
                    self._before[name] = seen
                    say(f"{name}: {seen}")
            for robot, address in status.forwarders.items():
                if self._before.get(address) != robot:
                    self._before[address] = robot
                    say(said(robot, address))


@contextmanager
def up_display(*, quiet: bool) -> Iterator[UpDisplay]:
    """The display of `robrain up` for as long as the block lasts."""
    if quiet or not console.is_terminal:
        yield UpDisplay(None, quiet=quiet)
        return
    with Live(console=console, refresh_per_second=5) as live:
        yield UpDisplay(live, quiet=False)


def show_up_result(result: UpResult) -> None:
    """How a team's time together ended."""
    say(
        f"{result.ended}: {result.explored_fraction:.1%} explored in {_clock(result.sim_time_s)}, "
        f"{result.collisions} collisions"
    )
    _say_recorded(result.recording)


def show_status(found: TeamFound) -> None:
    """Who of a team is there."""
    say(f"team {found.team}: coordinator {'up' if found.coordinator else 'not there'}")
    for name in found.robots:
        say(f"  {name} up")


def say(text: str) -> None:
    """A line for the person; text from elsewhere is shown as it is, without markup, and cannot steer the terminal."""
    console.print(escape("\n".join(map(safe_text, text.split("\n")))), soft_wrap=True)


def show_result(result: RunResult) -> None:
    """The summary of a run."""
    why = {
        "explored": "explored as far as asked",
        "nothing_left": "nothing left that a robot could reach",
        "time_limit": "time limit",
        "interrupted": "interrupted",
    }
    table = Table(
        title=escape(f"{result.scenario}, seed {result.seed}"), title_justify="left", box=None, pad_edge=False
    )
    for heading in ("robot", "distance", "energy", "collisions"):
        table.add_column(heading, justify="left" if heading == "robot" else "right")
    for robot in result.per_robot:
        table.add_row(escape(robot.name), f"{robot.distance_m:.1f} m", f"{robot.energy_j:.0f} J", str(robot.collisions))
    table.add_section()
    table.add_row("team", f"{result.distance_m:.1f} m", f"{result.energy_j:.0f} J", str(result.collisions))
    console.print()
    console.print(table)
    console.print(
        f"{result.explored_fraction:.1%} explored in {_clock(result.sim_time_s)} ({why[result.ended]}), "
        f"{result.real_time_factor:.1f} × real time, {result.messages} messages, "
        f"{result.mote_readings} readings of {result.motes} motes",
        soft_wrap=True,
    )
    _say_recorded(result.recording)


def _say_recorded(recording: str | None) -> None:
    if recording is not None:
        say(f"recorded in {recording}")
        say(f"replay it: robrain replay {recording}")


def _team_table(status: TeamStatus) -> Group:
    share = f"{status.explored_fraction:.1%} explored, {_clock(status.sim_time_s)}; Ctrl-C stops the team"
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_row("coordinator", "[green]up[/]" if status.coordinator_up else "[yellow]starting[/]")
    for name, text in status.robots:
        table.add_row(escape(name), escape(text), f"[dim]base station {status.forwarders.get(name, '–')}[/]")
    for name, exit_status, line in status.exited:
        table.add_row(f"[red]{escape(name)}[/]", f"exited with {exit_status}: {escape(line)}")
    return Group(share, table)


def _clock(seconds: float) -> str:
    minutes, rest = divmod(int(seconds), 60)
    return f"{minutes:02d}:{rest:02d}"
