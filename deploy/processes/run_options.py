"""The options of a run, and the page that follows it; read without the simulator."""

from pathlib import Path
from typing import NamedTuple

import msgspec
import zenoh

from robrain.deploy.processes.children import StartingPage


class RunOptions(msgspec.Struct, frozen=True, kw_only=True):
    """The options of a run, as the command line gives them."""

    until: str | None = None
    time_limit_s: float | None = None
    speed: float | None = None
    record: Path | None = None
    dashboard: bool = False
    port: int | None = None
    quiet: bool = False
    """Print only errors."""
    stay: bool = False
    """Keep the dashboard up after the run, until Ctrl-C: it then shows the recording."""


class Watched(NamedTuple):
    """A page, and the session on which it follows the run."""

    session: zenoh.Session
    page: StartingPage
