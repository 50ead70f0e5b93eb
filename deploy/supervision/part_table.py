"""The table of a team's processes, for `robrain up` and `robrain top`."""

from collections.abc import Sequence

from rich.console import Group
from rich.table import Table
from rich.text import Text

from robrain.deploy.supervision.part import PartView
from robrain.deploy.supervision.restarts import Phase
from robrain.protocol.safe_text import safe_text

COLOURS = {Phase.UP: "green", Phase.GIVEN_UP: "red", Phase.KILLED: "red"}
UNKNOWN = "–"
TITLES = ("part", "process", "CPU", "memory", "messages", "restarts", "state")


def drawn(heading: str, parts: Sequence[PartView]) -> Group:
    """The table below a line."""
    return Group(heading, table_of(parts))


def table_of(parts: Sequence[PartView]) -> Table:
    """One line for each process; unknown figures are dashes."""
    table = Table(box=None, pad_edge=False)
    for title in TITLES:
        is_text = title in ("part", "state")
        table.add_column(title, justify="left" if is_text else "right", no_wrap=not is_text, overflow="fold")
    for part in parts:
        *cells, state = cells_of(part)
        table.add_row(*cells, Text(state, COLOURS.get(part.phase, "yellow")))
    return table


def cells_of(part: PartView) -> list[str]:
    """The cells of a line; texts from elsewhere are made safe for a terminal."""
    is_up = part.phase is Phase.UP
    return [
        safe_text(part.name),
        UNKNOWN if part.pid is None else str(part.pid),
        UNKNOWN if part.cpu_share is None else f"{part.cpu_share:.0%}",
        UNKNOWN if part.memory_mb is None else f"{part.memory_mb:.0f} MB",
        safe_text(part.messages) or UNKNOWN,
        UNKNOWN if part.restarts is None else str(part.restarts),
        (safe_text(part.words) if is_up else "") or part.phase.value,
    ]


def lines_of(parts: Sequence[PartView]) -> list[str]:
    """The same as lines of text, for a file or a pipe."""
    rows = [list(TITLES), *map(cells_of, parts)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
