"""`make bench`: prints what was measured in this run, as tables. Nothing here fails on a timing."""

from rich.console import Console
from rich.table import Table

from tests.bench import (
    allocation,
    behaviors,
    charging,
    dashboard,
    energy,
    halt,
    live_planning,
    localisation,
    motes,
    motion,
    planning,
    plugin_host,
    real_time_factor,
    recording,
    responses,
    robot_cost,
    tasks,
    thousand_agents,
)


def main() -> None:
    """Run every benchmark."""
    table = Table(title="Lockstep runs against the bare pymunk loop of the same world (depot, 24 motes, one core)")
    for heading in ("robots", "whole run, ms / sim s", "bare pymunk, ms / sim s", "real-time factor", "whole / bare"):
        table.add_column(heading, justify="right")
    for row in real_time_factor.measure():
        table.add_row(
            str(row.robots),
            f"{row.whole_run_ms:.1f}",
            f"{row.bare_pymunk_ms:.2f}",
            f"{row.real_time_factor:.1f}",
            f"{row.ratio:.0f}",
        )
    Console(width=110).print(table)
    for what, measure in (
        ("The plugin host", plugin_host.measure),
        ("Motion on CAN", motion.measure),
        ("Battery and energy", energy.measure),
        ("Motes", motes.measure),
        ("Localisation", localisation.measure),
        ("Behaviors", behaviors.measure),
        ("Allocation", allocation.measure),
        ("Tasks", tasks.measure),
        ("Planning", planning.measure),
        ("Chargers", charging.measure),
        ("Plans beside the live coordinator", live_planning.measure),
        ("Recordings", recording.measure),
        ("Response time", responses.measure),
        ("A thousand agents", thousand_agents.measure),
        ("The dashboard with 100 robots and 400 motes, browsers in software rendering", dashboard.measure),
    ):
        table = Table(title=f"{what}, each figure beside what it is compared with and the bound that it is to keep")
        for heading in ("what", "measured", "beside", "bound", "kept"):
            table.add_column(heading)
        for figure in measure():
            table.add_row(figure.what, figure.value, figure.beside, figure.bound, "yes" if figure.is_kept else "no")
        Console(width=110).print(table)
    table = Table(title="One robot's whole stack, by part, for each robot and simulated second (depot)")
    for heading in ("part", "CPU, ms", "calls", "bound, ms", "kept"):
        table.add_column(heading, justify="left" if heading == "part" else "right")
    for cost in robot_cost.measure():
        kept = {True: "yes", False: "no", None: ""}[cost.is_kept]
        bound = "" if cost.bound_ms is None else f"{cost.bound_ms:g}"
        table.add_row(cost.part, f"{cost.ms:.2f}", f"{cost.calls:.1f}" if cost.calls else "", bound, kept)
    Console(width=110).print(table)
    table = Table(
        title=f"Emergency halt: from its put in another process to the stop frame (p99 ≤ {halt.BOUND_MS:g} ms)"
    )
    for heading in ("in the robot", "median, ms", "p99, ms", "slowest, ms", "halts"):
        table.add_column(heading, justify="left" if heading == "in the robot" else "right")
    for took in halt.measure():
        figures = (f"{took.median_ms:.1f}", f"{took.p99_ms:.1f}", f"{took.slowest_ms:.1f}", str(took.rounds))
        table.add_row(took.case, *figures)
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
