"""A whole run in a few figures, for its table and to compare it with others."""

from collections.abc import Iterable

from robrain.coordinator.recording.run_data import RunData

ENDED_BADLY = ("failed", "lost_contact")


def totals(run: RunData) -> dict[str, float | None]:
    """Figures of a whole run, for the table and for comparison; None where nothing tells."""
    robots = run.robots.values()
    states = [task.state for task in run.tasks.values()]
    return {
        "Duration (s)": run.duration_s,
        "Explored (%)": 100 * run.explored[-1][1] if run.explored else None,
        "Known area (m²)": run.map.known_area_m2 or None,
        "Robots": float(len(run.robots)),
        "Motes heard": float(len(run.motes)),
        "Distance (m)": _sum(robot.distance_m for robot in robots),
        "Energy (kJ)": _sum(None if robot.energy_j is None else robot.energy_j / 1000 for robot in robots),
        "Collisions": _sum(robot.collisions for robot in robots),
        "Tasks done": float(states.count("done")),
        "Tasks failed": float(sum(state in ENDED_BADLY for state in states)),
        "Faults": float(sum(happening.lasts for happening in run.happenings)),
        "Messages": float(run.contents.info.messages),
        "File (MB)": run.contents.info.size_bytes / 1e6,
    }


def _sum(values: Iterable[float | None]) -> float | None:
    told = [value for value in values if value is not None]
    return float(sum(told)) if told else None
