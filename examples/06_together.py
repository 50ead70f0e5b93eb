"""Dependent tasks: one task after another, and one for two robots at once."""

from robrain import Scenario

with Scenario.builtin("arena_small").replace(robots=3).team(seed=5) as team:
    team.run_for(1.0)
    fetch = team.submit("visit", id="fetch", place=(1.0, 1.0), service_s=3.0)
    bring = team.submit("visit", id="bring", place=(4.2, 3.0), service_s=3.0, after=[fetch])
    lift = team.submit("visit", id="lift", place=(3.6, 4.8), service_s=5.0, robots=2)
    for record in team.wait_all([fetch, bring, lift]):
        began = [change for change in team.why(record).changes if change.state == "running"]
        who = record.robot or "two robots"
        times = f"began at {began[-1].stamp_ns / 1e9:.1f} s, ended at {record.changed_ns / 1e9:.1f} s"
        print(f"{record.task.id:6}{record.state} by {who}, {times}")
