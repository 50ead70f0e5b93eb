"""Terminal output of soaks: a progress bar on stderr, results on stdout."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.table import Table

from robrain.deploy.command_line.terminal import print_line, results
from robrain.lab.soak.fault_script import FaultScript
from robrain.lab.soak.judge import Broken
from robrain.lab.soak.soaking import SoakResult
from robrain.lab.soak.trial import TrialVerdict
from robrain.lab.sweep.sweep_display import counting_bar
from robrain.sim.faults.fault_spec import FaultSpec

SHOWN_FAILURES = 20


@contextmanager
def soak_display(runs: int, *, quiet: bool = False) -> Iterator[Callable[[SoakResult], None]]:
    """A bar for the duration of the block."""
    with counting_bar("scripts", runs, quiet=quiet) as update:
        yield lambda now: update(now.runs, f"{len(now.failures)} broken" if now.failures else "")


def show_soak(result: SoakResult) -> None:
    """Print the results of a soak."""
    if result.failures:
        table = Table(box=None, pad_edge=False, header_style="bold")
        for name in ("seed", "invariant", "at s", "faults", "tasks", "what"):
            table.add_column(name, justify="left" if name in ("invariant", "what") else "right")
        for failure in result.failures[:SHOWN_FAILURES]:
            first = failure.broken[0]
            table.add_row(
                str(failure.seed),
                first.invariant.value,
                f"{first.at_s:.1f}",
                str(failure.faults),
                str(failure.tasks),
                first.what,
            )
        results().print(table)
        if len(result.failures) > SHOWN_FAILURES:
            print_line(f"… and {len(result.failures) - SHOWN_FAILURES} more")
        print_line("")
        for failure in result.failures[:SHOWN_FAILURES]:
            print_line(failure.repeat)
        print_line("")
    for error in result.errors:
        print_line(error)
    print_line(
        f"{result.runs} scripts, {len(result.failures)} broke an invariant; "
        f"{result.tasks_done} tasks done in {result.sim_time_s / 3600.0:.1f} h of simulated time"
    )
    print_line(
        f"{sum(result.faults.values())} faults: {', '.join(f'{count} {kind}' for kind, count in result.faults.items())}"
    )
    rate = result.runs / result.wall_time_s * 60.0 if result.wall_time_s else 0.0
    print_line(
        f"{result.wall_time_s:.0f} s, {rate:.0f} scripts a minute, {result.speed:.0f} × real time in each process"
    )
    if result.interrupted:
        print_line("interrupted")


def show_script(script: FaultScript, verdict: TrialVerdict) -> None:
    """Print the content of a repeated script, and its outcome."""
    print_line(f"{len(script.robots)} robots, {len(script.tasks)} tasks, method {script.method}")
    for halt in script.halts:
        print_line(f"  halt from {halt.at_s:g} s to {halt.until_s:g} s")
    for fault in script.faults:
        print_line(f"  {fault_text(fault)}")
    for broken in verdict.broken:
        print_line(broken_text(broken))
    if not verdict.broken:
        print_line(f"no invariant broken in {verdict.sim_time_s:g} s; {verdict.done} tasks done")


def fault_text(fault: FaultSpec) -> str:
    """A fault in one line.

    >>> fault_text(FaultSpec(robot="r1", kind="hang", at_s=2.0, until_s=5.0))
    'r1: hang from 2 s to 5 s'
    """
    until = "" if fault.until_s is None else f" to {fault.until_s:g} s"
    after = "" if fault.on is None else f" after {fault.on.value.replace('_', ' ')}"
    options = {
        "share": fault.share, "late_s": fault.late_s, "skew_s": fault.skew_s, "period_s": fault.period_s,
        "soc": fault.soc, "side": ", ".join(fault.side) or None,
    }  # fmt: skip
    words = ", ".join(f"{name} = {value}" for name, value in options.items() if value is not None)
    begins = "from" if until else "at"
    kind = str(fault.kind).replace("_", " ")
    return f"{fault.robot}: {kind} {begins} {fault.at_s:g} s{until}{after}{f' ({words})' if words else ''}"


def broken_text(broken: Broken) -> str:
    """A broken invariant in one line."""
    return f"{broken.invariant.value} at {broken.at_s:g} s: {broken.what}"
