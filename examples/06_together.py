"""Work that hangs together: one task after another, and one that takes two robots at once."""

from robrain import LockstepTeam, Point2D, Scenario, Visit

with LockstepTeam(Scenario.builtin("arena_small").replace(robots=3, seed=5)) as team:
    team.run_for(1.0)
    team.submit(Visit(id="fetch", place=Point2D(1.0, 1.0), service_s=3.0))
    team.submit(Visit(id="bring", place=Point2D(4.2, 3.0), service_s=3.0, after=("fetch",)))
    team.submit(Visit(id="lift", place=Point2D(3.6, 4.8), service_s=5.0, robots=2))
    for record in team.wait("fetch", "bring", "lift"):
        began = [change for change in team.why(record.task.id).changes if change.state == "running"]
        who = record.robot or "two robots"
        times = f"began at {began[-1].stamp_ns / 1e9:.1f} s, ended at {record.changed_ns / 1e9:.1f} s"
        print(f"{record.task.id:6}{record.state} by {who}, {times}")
