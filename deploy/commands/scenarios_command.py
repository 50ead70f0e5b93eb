"""`robrain scenarios`: the scenarios that come with robrain."""

import sys
from typing import TYPE_CHECKING

from robrain.deploy.command_line.team_options import JsonOption

if TYPE_CHECKING:
    from robrain.sim.scenarios.listing import ListedScenario


def scenarios(as_json: JsonOption = False) -> None:
    """List the scenarios that come with robrain; `robrain run NAME` runs one."""
    from robrain.sim.scenarios.listing import listed_scenarios

    found = listed_scenarios()
    if as_json:
        import msgspec

        sys.stdout.write(msgspec.json.encode({"scenarios": found}).decode() + "\n")
    else:
        _show(found)


def _show(found: "list[ListedScenario]") -> None:
    from rich.table import Table

    from robrain.deploy.command_line.terminal import results

    table = Table(box=None, pad_edge=False)
    for heading in ("name", "floor", "robots", "motes"):
        table.add_column(heading, justify="left" if heading == "name" else "right", no_wrap=True)
    table.add_column("about")
    for one in found:
        size = f"{one.width_m:g} × {one.height_m:g} m"
        table.add_row(one.name, size, str(one.robots), str(one.motes), one.about)
    results().print(table)
