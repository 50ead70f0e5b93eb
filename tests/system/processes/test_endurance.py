"""What the long run of a live team judges, and that it sees every process."""

from pathlib import Path

import pytest

from tests.system.endurance import Endured, Sample, draw_plot, endure, verdict, write_csv


def run_of(minutes: float = 30.0, **changes) -> Endured:
    """A run whose two processes need more at first, and then what `changes` say for the second: a function of hours."""
    samples = []
    for step in range(int(minutes * 12)):
        hours = step / 720.0
        settled = min(1.0, step / (minutes * 3))
        for pid, name in ((10, "r1"), (11, "coordinator")):
            values = {"memory_mb": 100.0 + 50.0 * settled, "descriptors": 20, "threads": 15, "pid": pid}
            if name == "coordinator":
                values |= {field: values[field] + change(hours) for field, change in changes.items()}
            samples.append(Sample(name=name, time_s=5.0 * step, cpu_s=0.2 * step, **values))
    return Endured(samples, ["e1", "e2"], {"e1": "done", "e2": "cancelled"}, 3)


@pytest.mark.parametrize(
    ("run", "reports"),
    [
        (run_of(), []),
        (run_of(memory_mb=lambda hours: 60.0 * hours), ["coordinator: memory grew by 13.3 MiB in 13 min"]),
        (run_of(descriptors=lambda hours: int(40 * hours)), ["coordinator: descriptors grew from 28 to 37"]),
        (run_of(pid=lambda hours: int(hours > 0.3)), ["coordinator: was started again"]),
        (run_of(4.0, memory_mb=lambda hours: 60.0 * hours), []),  # too short to judge
        (run_of()._replace(ended={"e1": "done", "e2": "queued"}), ["1 of 2 tasks have not ended: e2"]),
        (run_of(0.5), ["r1: 6 samples are too few", "coordinator: 6 samples are too few"]),
    ],
)
def test_growth_restarts_and_open_tasks_are_reported(run: Endured, reports: list[str]) -> None:
    assert verdict(run) == reports


@pytest.mark.system
def test_every_process_of_a_live_team_is_seen_and_its_tasks_end(tmp_path: Path):
    run = endure(tmp_path, 0.15, robots=1, seed=1, scenario="arena_small")
    parts = {"up", "hub", "arena", "coordinator", "record", "dashboard", "r1"}
    assert {sample.name for sample in run.samples} == parts
    assert all(sample.memory_mb > 10 and sample.threads > 0 and sample.descriptors > 3 for sample in run.samples)
    assert run.submitted
    assert set(run.ended.values()) == {"done"}
    write_csv(run.samples, tmp_path / "samples.csv")
    assert len((tmp_path / "samples.csv").read_text().splitlines()) == len(run.samples) + 1
    draw_plot(run.samples, tmp_path / "plot.png")
    assert (tmp_path / "plot.png").read_bytes().startswith(b"\x89PNG")
