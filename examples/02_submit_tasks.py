"""Tasks with place, priority and deadline. The coordinator assigns them to robots and explains its decisions."""

from robrain import Scenario

with Scenario.builtin("arena_small").replace(robots=2).team(seed=3) as team:
    team.run_for(1.0)  # the robots start and scan
    team.submit("visit", id="door", place=(4.2, 3.0), service_s=2.0)
    team.submit("visit", id="corner", place=(1.0, 1.0), priority=5.0)
    team.submit("inspect", id="picture", place=(6.0, 3.0), deadline_s=60.0, parameters={"look_at": (7.5, 5.0)})

    for record in team.wait_all(["door", "corner", "picture"]):
        result = record.result
        print(
            f"{record.task.id:8}{record.state} by {record.robot}: {result['path_length_m']} m, {result['energy_j']} J"
        )

    print("corner:", team.why("corner").now)
    for change in team.why("corner").changes:
        print(f"  {change.stamp_ns / 1e9:5.1f} s  {change.state}  {change.robot}")
    print(f"{team.now_s:.0f} simulated seconds")
