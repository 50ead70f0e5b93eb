"""The parts of a team on one machine, and the commands that start them."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from robrain.deploy.supervision.part import (
    COORDINATOR,
    DASHBOARD,
    HUB,
    HUB_POLICY,
    RECORDER,
    STAND_BY,
    Part,
)
from robrain.deploy.supervision.team_status import TeamWatch
from robrain.protocol.messages.robots.witness_messages import WITNESSES_MAX

if TYPE_CHECKING:  # brings the simulator, which the machine of a real robot does not need
    pass


RECORDER_STOP_S = 60.0
"""Time for a recorder to write waiting messages and to finish its file, on a slow disk."""


class Site(NamedTuple):
    """Site of the parts: this machine's folder, and the team's endpoint."""

    folder: Path
    """For files that only this run needs."""
    endpoint: str
    """Of the hub."""
    team: str
    watch: TeamWatch
    is_private: bool
    """Whether no other machine can reach the hub."""

    @property
    def common(self) -> list[str]:
        """Arguments of every part but the hub."""
        return ["--connect", self.endpoint, "--team", self.team]


def hub_part(listen: Callable[[], str], on_line: Callable[[str], None]) -> Part:
    """The hub.

    Args:
        listen: the endpoint; called at each start, so that it keeps its port.
        on_line: called with each line that it prints.

    """
    return Part(
        HUB, lambda _: ["hub", "--listen", listen()], HUB_POLICY, is_vital=True, must_start=True, on_line=on_line
    )


def router_part(listen: Callable[[], str], on_line: Callable[[str], None]) -> Part:
    """The router of a secured team, in place of the hub; arguments as of `hub_part`."""
    return hub_part(listen, on_line)._replace(arguments=lambda _: ["router", "--listen", listen()])


def witnesses_among(robots: Sequence[str]) -> list[str]:
    """The robots of a team that elect its coordinator: an odd number, so that no vote ends in a tie.

    >>> witnesses_among(["r1", "r2", "r3", "r4"])
    ['r1', 'r2', 'r3']
    """
    count = min(len(robots), WITNESSES_MAX)
    return list(robots[: count - (count % 2 == 0)]) if robots else []


def coordinator_parts(
    site: Site, journal: Path, options: Sequence[str], parts: Sequence[str], witnesses: Sequence[str]
) -> list[Part]:
    """The coordinator, and a stand-by coordinator with its own journal.

    Args:
        site: site of their start.
        journal: file of the coordinator; the other's is `NAME-stand-by` beside it.
        options: further arguments of both.
        parts: names of the parts that run here.
        witnesses: robots that elect one of them; none if the coordinator is alone.

    """
    words = ["coordinator", *options, *site.common, *(["--witnesses", ",".join(witnesses)] if witnesses else [])]
    files = {COORDINATOR: journal, STAND_BY: journal.with_stem(f"{journal.stem}-stand-by")}

    def part(name: str) -> Part:
        return Part(name, lambda _: [*words, "--journal", str(files[name])])

    return [part(name) for name in files if name in parts]


def dashboard_part(site: Site, port: Callable[[], int | None], on_line: Callable[[str], None]) -> Part:
    """The dashboard; `port` is called at each start, so that it keeps its page's address."""

    def arguments(_: int) -> list[str]:
        number = port()
        return ["dashboard", *site.common, *([] if number is None else ["--port", str(number)])]

    return Part(DASHBOARD, arguments, must_start=True, on_line=on_line)


def recorder_part(site: Site, path: Path, provenance: Path | None, on_line: Callable[[str], None]) -> Part:
    """The recorder. A restarted recorder writes a new file: a recording is never overwritten."""

    def arguments(start: int) -> list[str]:
        words = ["record", "--output", str(again_path(path, start)), "--json", *site.common]
        return words if provenance is None else [*words, "--provenance", str(provenance)]

    return Part(RECORDER, arguments, must_start=True, stop_s=RECORDER_STOP_S, on_line=on_line)


def agent_part(site: Site, name: str, path: Path, journal: Path) -> Part:
    """The agent of a robot that has its own file."""
    return Part(name, lambda _: ["agent", str(path), *site.common, *votes_option(journal)])


def votes_option(journal: Path) -> list[str]:
    """Folder of the robots' votes: beside the journal of the coordinator for which they vote."""
    return ["--votes", str(journal.with_name(f"{journal.name}.votes"))]


def again_path(path: Path, start: int) -> Path:
    """The file of a recorder's start.

    >>> again_path(Path("runs/live.mcap"), 1).as_posix(), again_path(Path("runs/live.mcap"), 2).as_posix()
    ('runs/live.mcap', 'runs/live_again_2.mcap')
    """
    return path if start == 1 else path.with_name(f"{path.stem}_again_{start}{path.suffix}")
