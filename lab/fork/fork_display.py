"""Terminal output of `robrain fork`: how the part before compares, and both runs beside each other."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, Progress

from robrain.deploy.command_line.terminal import clock_of, console, own_command, print_line, print_progress, text_column
from robrain.deploy.recordings.recording_display import show_two_runs, where_different
from robrain.lab.fork.fork_result import ForkResult
from robrain.recording.reader.two_runs import TwoRuns
from robrain.sim.scenarios.driving import Progress as RunProgress

END_REASONS = {
    "explored": "target reached",
    "nothing_left": "nothing left that a robot could reach",
    "time_limit": "time limit",
    "interrupted": "interrupted",
    "as_recorded": "as long as the recording",
    "seconds": "as long as asked",
}
DIGITS = 16
"""Of a digest that are shown."""


@contextmanager
def fork_display(at_s: float, *, quiet: bool = False) -> Iterator[Callable[[RunProgress], None]]:
    """A bar for the duration of the block, first to the moment, then on; nothing if the stream is not a terminal."""
    columns = (
        text_column("{task.description}"),
        BarColumn(bar_width=30),
        text_column("{task.fields[clock]} simulated, {task.fields[explored]} explored"),
    )
    with Progress(*columns, console=console, disable=quiet or not console.is_terminal, transient=True) as progress:
        bar = progress.add_task("again", total=max(at_s, 1e-9), clock="", explored="")

        def show(now: RunProgress) -> None:
            progress.update(
                bar,
                description="again" if now.sim_time_s < at_s else "what if",
                completed=min(now.sim_time_s, at_s),
                clock=clock_of(now.sim_time_s),
                explored=f"{now.explored_fraction:.1%}",
            )

        yield show


def show_fork(result: ForkResult, runs: TwoRuns | None) -> None:
    """Print how a fork went."""
    for words in result.other_versions:
        print_progress(f"warning: made with {words}; the part before may differ for that")
    for time_s, key in result.not_repeated[:5]:
        print_progress(f"warning: what came from another process at {time_s:.2f} s on {key} cannot be repeated")
    before = f"before {result.at_s:g} s: "
    if result.same_before:
        print_line(f"{before}equal, {result.messages_before} messages, digest {result.digest_before[:DIGITS]}")
    else:
        print_line(
            f"{before}NOT equal after {result.messages_before} messages, digest {result.digest_before[:DIGITS]}, "
            f"recorded {result.recorded_digest_before[:DIGITS]}"
        )
    if result.difference is not None:
        for line in where_different(result.parent, result.recording, result.difference):
            print_line(line)
    if result.same_whole is not None:
        whole = f"equal, digest {result.digest[:DIGITS]}" if result.same_whole else "NOT equal"
        print_line(f"nothing changed, whole run: {whole}")
    else:
        print_line(f"after it: {', '.join(result.changes) or 'nothing changed'}")
    print_line(
        f"{result.explored_fraction:.1%} explored in {clock_of(result.sim_time_s)} ({END_REASONS[result.ended]}), "
        f"{result.messages} messages"
    )
    if runs is not None:
        show_two_runs(runs)
    print_line(f"recorded in {result.recording}")
    print_progress(f"replay it: {own_command('replay', result.recording)}")
