"""Terminal output of a lockstep run: a progress bar and the summary."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from rich.progress import BarColumn, Progress

from robrain.deploy.command_line.terminal import (
    both_at_a_terminal,
    clock_of,
    console,
    new_table,
    own_command,
    print_line,
    print_progress,
    results,
    text_column,
)
from robrain.protocol.messages.maps.map_messages import ExplorationLeft, LeftKind
from robrain.protocol.messages.team.arena_messages import LinkCounters
from robrain.protocol.model.accuracy import MapAccuracy, PoseAccuracy
from robrain.protocol.reasons import NothingUnknown
from robrain.sim.lockstep.result import RunResult
from robrain.sim.scenarios.driving import Progress as RunProgress
from robrain.sim.world.referee import GapTooNarrow

LEFT_ROWS = 10
"""Regions in the table of unexplored regions."""


@contextmanager
def run_display(until_explored: float, *, quiet: bool = False) -> Iterator[Callable[[RunProgress], None]]:
    """A progress bar for the duration of the block; prints nothing if the stream is not a terminal."""
    columns = (text_column("{task.description}"), BarColumn(bar_width=30), text_column("{task.completed:6.1%}"))
    with Progress(
        *columns,
        text_column("{task.fields[clock]}", "dim"),
        console=console,
        disable=quiet or not console.is_terminal,
        redirect_stdout=both_at_a_terminal(),
    ) as bars:
        bar = bars.add_task("explored", total=until_explored, clock="")
        last: RunProgress | None = None
        speed = 0.0

        def show(now: RunProgress) -> None:
            """Draw the progress; the speed is that of about the last second."""
            nonlocal last, speed
            if last is None:
                last = now
            elapsed_s = now.wall_time_s - last.wall_time_s
            if elapsed_s > 0.5:
                speed = (now.sim_time_s - last.sim_time_s) / elapsed_s
                last = now
            clock = f"{clock_of(now.sim_time_s)} simulated  {speed:5.1f} × real time"
            bars.update(bar, completed=now.explored_fraction, clock=clock)

        yield show


def show_result(result: RunResult) -> None:
    """Print the summary of a run."""
    reasons = {
        "explored": "target reached",
        "nothing_left": "nothing left that a robot could reach",
        "tasks_ended": "all tasks have ended",
        "time_limit": "time limit",
        "interrupted": "interrupted",
    }
    numbers = ("distance", "energy", "collisions")
    table = new_table("robot", *numbers, right=numbers, title=f"{result.scenario}, seed {result.seed}")
    for robot in result.per_robot:
        table.add_row(robot.name, f"{robot.distance_m:.1f} m", f"{robot.energy_j:.0f} J", str(robot.collisions))
    table.add_section()
    table.add_row("team", f"{result.distance_m:.1f} m", f"{result.energy_j:.0f} J", str(result.collisions))
    console = results()
    console.print(table)
    console.print(
        f"{result.explored_fraction:.1%} explored in {clock_of(result.sim_time_s)} ({reasons[result.ended]}), "
        f"{result.real_time_factor:.1f} × real time, {result.messages} messages, "
        f"{result.mote_readings} readings of {result.motes} motes",
        soft_wrap=True,
    )
    if result.links is not None:
        print_line(links_line(result.links))
    positions = {robot.name: robot.pose_accuracy for robot in result.per_robot}
    for line in accuracy_lines(result.map_accuracy, positions):
        print_line(line)
    for task in result.tasks:
        print_line(task.words)
    for left in result.floor_left:
        if result.ended == "nothing_left" or isinstance(left.why, GapTooNarrow):
            print_line(left.words)
    if result.exploration_left is not None:
        print_exploration_left(result.exploration_left)
    if result.ended == "nothing_left":
        for robot in result.per_robot:
            if robot.idle is not None and not isinstance(robot.idle, NothingUnknown):
                print_line(f"{robot.name} is {robot.idle!s}")
    print_recorded(result.recording)


def print_exploration_left(left: ExplorationLeft) -> None:
    """Print the unexplored regions: a line for those that robots can still reach, a table for the rest."""
    unseen = [region for region in left.regions if region.kind is LeftKind.UNSEEN and region.gap_m is None]
    regions = [region for region in left.regions if region not in unseen]
    if unseen:
        largest = unseen[0]
        print_line(
            f"not seen yet: {len(unseen)} place{'s' if len(unseen) > 1 else ''} that robots can reach, "
            f"at most {sum(one.area_m2 for one in unseen):.1f} m² together with the inside of obstacles; the largest "
            f"is near ({largest.place.x_m:.1f}, {largest.place.y_m:.1f})"
        )
    if not regions and not left.more:
        return
    headings = ("kind", "x, y", "area", "box", "why")
    table = new_table(*headings, right=["area"], title="left to explore, by the team's map")
    for region in regions[:LEFT_ROWS]:
        place, low, high = region.place, region.low, region.high
        table.add_row(
            region.kind.value,
            f"{place.x_m:.1f}, {place.y_m:.1f}",
            f"{region.area_m2:.1f} m²",
            f"{low.x_m:.1f}, {low.y_m:.1f} to {high.x_m:.1f}, {high.y_m:.1f}",
            region.words,
        )
    if regions:
        results().print(table)
    hidden = regions[LEFT_ROWS:]
    if more := len(hidden) + left.more:
        print_line(f"and {more} smaller regions, {sum(one.area_m2 for one in hidden) + left.more_m2:.1f} m² in all")


def links_line(links: LinkCounters) -> str:
    """Counters of messages between robots and coordinator."""
    missed = links.lost + links.crowded + links.out_of_reach + links.overflowed
    sent = links.delivered + missed
    share = f"{links.delivered / sent:.1%} of {sent} messages delivered" if sent else "no messages sent"
    return (
        f"radio: {share}; {links.out_of_reach} out of reach, "
        f"{links.lost} lost, {links.crowded + links.overflowed} dropped; {links.timed_out} of {links.asked} queries "
        "timed out"
    )


def accuracy_lines(of_map: MapAccuracy | None, positions: Mapping[str, PoseAccuracy | None]) -> list[str]:
    """Accuracy of the map and of the positions, a line each; a missing measurement is skipped."""
    lines = []
    if of_map is not None:
        lines.append(
            f"map: {of_map.share_off:.1%} of its {of_map.occupied_cells} wall cells are where no wall is, "
            f"{of_map.doubled_walls_m:.1f} m of wall are in it twice"
        )
    known = {name: each for name, each in positions.items() if each is not None}
    if known:
        rmse_m = {name: each.rmse_m for name, each in known.items() if each.rmse_m is not None}
        error_m = {name: each.max_error_m for name, each in known.items() if each.max_error_m is not None}
        silent = [
            f"{name} {each.silent_divergence_s:.1f} s" for name, each in known.items() if each.silent_divergence_s > 0
        ]
        lost = [f"{name} {each.lost_s:.1f} s" for name, each in known.items() if each.lost_s > 0]
        parts = []
        if rmse_m and error_m:
            worst, farthest = max(rmse_m, key=rmse_m.__getitem__), max(error_m, key=error_m.__getitem__)
            parts = [
                f"RMSE {rmse_m[worst]:.3f} m ({worst}, the worst)",
                f"at most {error_m[farthest]:.3f} m ({farthest})",
            ]
        parts += [f"larger than reported: {', '.join(silent) or 'none'}", f"lost: {', '.join(lost) or 'none'}"]
        lines.append(f"position errors: {', '.join(parts)}")
    return lines


def print_recorded(recording: str | None) -> None:
    """Print a recording's path and the command that replays it."""
    if recording is not None:
        print_line(f"recorded in {recording}")
        print_progress(f"replay it: {own_command('replay', recording)}")
