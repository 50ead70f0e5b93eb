"""What is a good plan? The same tasks planned for least energy and for the earliest end, and why each went where."""

from robrain import LockstepTeam, Objective, PlanningPolicy, Point2D, Scenario, Visit

PLACES = [(1.0, 1.0), (2.0, 1.0), (1.0, 2.8), (2.2, 3.0), (4.0, 1.0), (4.2, 3.0)]


def work(objective: Objective) -> None:
    """Have the same team do the same tasks, and say how it went."""
    policy = PlanningPolicy(objective=objective)
    scenario = Scenario.builtin("arena_small").replace(robots=2, motes=0, seed=6, planning=policy)
    with LockstepTeam(scenario) as team:
        team.run_for(40.0)  # first the floor is explored
        began_s = team.now_s
        names = [f"visit-{number}" for number in range(len(PLACES))]
        for name, (x_m, y_m) in zip(names, PLACES, strict=True):
            team.submit(Visit(id=name, place=Point2D(x_m, y_m), service_s=4.0))
        records = team.wait(*names)
        energy_j = sum(record.result["energy_j"] for record in records)
        busy = {robot: sum(record.robot == robot for record in records) for robot in team.robots}
        print(f"{objective}: {energy_j:.0f} J, {team.now_s - began_s:.0f} s, tasks of each {busy}")
        for verdict in team.why("visit-5").robots:
            figures = "" if verdict.energy_j is None else f" {verdict.energy_j:.0f} J"
            did = "did it" if verdict.robot == records[-1].robot else verdict.why_not
            print(f"  visit-5 to {verdict.robot}:{figures} {did}")


for objective in (Objective.ENERGY, Objective.MAKESPAN):
    work(objective)
