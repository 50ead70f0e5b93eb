"""What the parts of one machine are started with."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from robrain.deploy.supervision.part import COORDINATOR, DASHBOARD, HUB, HUB_POLICY, RECORDER, STAND_BY, Part
from robrain.deploy.supervision.team_watch import TeamWatch

RECORDER_STOP_S = 60.0
"""Time for a recorder to write what waits and to finish its file, on a slow disk."""


class Site(NamedTuple):
    """Where parts are started: this machine's folder, and the team's endpoint."""

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


MakeParts = Callable[[Site], list[Part]]


def hub_part(listen: Callable[[], str], on_line: Callable[[str], None]) -> Part:
    """The hub.

    Args:
        listen: the endpoint; asked at each start, so that it keeps its port.
        on_line: called with each line that it prints.

    """
    return Part(
        HUB, lambda _: ["hub", "--listen", listen()], HUB_POLICY, is_vital=True, must_start=True, on_line=on_line
    )


def router_part(listen: Callable[[], str], on_line: Callable[[str], None]) -> Part:
    """The router of a secured team, in place of the hub; arguments as of `hub_part`."""
    return hub_part(listen, on_line)._replace(arguments=lambda _: ["router", "--listen", listen()])


def coordinator_parts(site: Site, journal: Path, options: Sequence[str], *, first: bool, stands_by: bool) -> list[Part]:
    """The coordinator, and one that stands by with the same journal.

    Args:
        site: where they are started.
        journal: the file of both.
        options: further arguments of both.
        first: whether the coordinator runs here.
        stands_by: whether the one that stands by does.

    """
    words = ["coordinator", "--journal", str(journal), *options, *site.common]

    def arguments(start: int) -> list[str]:
        # The one that stands by coordinates by the time that this one is started again.
        return [*words, "--stand-by"] if stands_by and start > 1 else words

    parts = [Part(COORDINATOR, arguments)] if first else []
    return [*parts, Part(STAND_BY, lambda _: [*words, "--stand-by"])] if stands_by else parts


def dashboard_part(site: Site, port: Callable[[], int | None], on_line: Callable[[str], None]) -> Part:
    """The dashboard; `port` is asked at each start, so that it keeps its page's address."""

    def arguments(_: int) -> list[str]:
        number = port()
        return ["dashboard", *site.common, *([] if number is None else ["--port", str(number)])]

    return Part(DASHBOARD, arguments, must_start=True, on_line=on_line)


def recorder_part(site: Site, path: Path, provenance: Path | None, on_line: Callable[[str], None]) -> Part:
    """The recorder. Started again, it goes on in a file of its own: a recording is never overwritten."""

    def arguments(start: int) -> list[str]:
        words = ["record", "--output", str(again_path(path, start)), "--json", *site.common]
        return words if provenance is None else [*words, "--provenance", str(provenance)]

    return Part(RECORDER, arguments, must_start=True, stop_s=RECORDER_STOP_S, on_line=on_line)


def agent_part(site: Site, name: str, path: Path) -> Part:
    """The agent of a robot that has a file of its own."""
    return Part(name, lambda _: ["agent", str(path), *site.common])


def again_path(path: Path, start: int) -> Path:
    """The file of a recorder's start.

    >>> again_path(Path("runs/live.mcap"), 1).as_posix(), again_path(Path("runs/live.mcap"), 2).as_posix()
    ('runs/live.mcap', 'runs/live_again_2.mcap')
    """
    return path if start == 1 else path.with_name(f"{path.stem}_again_{start}{path.suffix}")
