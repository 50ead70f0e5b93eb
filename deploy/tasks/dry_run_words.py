"""What would follow from a task, and what it takes each robot, in words."""

from robrain.protocol.messages.tasks.task_messages import RobotVerdict, TaskDryRun


def verdict_line(verdict: RobotVerdict) -> str:
    """What a task takes a robot, or why the robot is excluded."""
    words = [f"{verdict.distance_m:.1f} m away"] if verdict.distance_m is not None else []
    words += [f"{verdict.time_s:.0f} s"] if verdict.time_s is not None else []
    words += [f"{verdict.energy_j:.0f} J"] if verdict.energy_j is not None else []
    words += ["chosen"] if verdict.chosen else [verdict.why_not] if verdict.why_not else []
    return f"  {verdict.robot}: {', '.join(words)}"


def dry_run_lines(found: TaskDryRun) -> list[str]:
    """What would follow from a task."""
    task = found.task
    if found.refused:
        return [f"a task to {task.kind} would be refused: {found.refused}"]
    if found.known is not None:
        return [f"{task.id} was submitted before, and is {found.known}: nothing would change"]
    lines = [f"a task to {task.kind} at ({task.place.x_m:g}, {task.place.y_m:g}) would be accepted"]
    if found.waits:
        lines.append(f"it would wait: {found.waits}")
    if found.ahead:
        lines.append(f"open tasks that are at least as urgent: {found.ahead}")
    if found.robots:
        lines += ["by a straight line, so at least:", *map(verdict_line, found.robots)]
    return lines
