"""Planning objectives: the same tasks planned for least energy and for the earliest end, with the decisions."""

from robrain import Objective, PlanningPolicy, Scenario

PLACES = [(1.0, 1.0), (2.0, 1.0), (1.0, 2.8), (2.2, 3.0), (4.0, 1.0), (4.2, 3.0)]


def work(policy: PlanningPolicy) -> None:
    """Run the same tasks with the same team, and print the result."""
    scenario = Scenario.builtin("arena_small").replace(robots=2, motes=0, planning=policy)
    with scenario.team(seed=6) as team:
        team.run_for(40.0)  # explore the floor first
        began_s = team.now_s
        tasks = [team.submit("visit", place=place, service_s=4.0) for place in PLACES]
        verdicts = team.why(tasks[-1]).robots
        records = team.wait_all(tasks)
        energy_j = sum(record.result["energy_j"] for record in records)
        busy = {robot: sum(record.robot == robot for record in records) for robot in team.robots}
        print(f"{policy.objective}: {energy_j:.0f} J, {team.now_s - began_s:.0f} s, tasks of each {busy}")
        for verdict in verdicts:
            figures = "" if verdict.energy_j is None else f" {verdict.energy_j:.0f} J"
            did = "did it" if verdict.robot == records[-1].robot else ""
            print(f"  visit-6 to {verdict.robot}:{figures} {did}")


work(PlanningPolicy(objective=Objective.ENERGY, delay_w=0.0))  # by default, a second counts as 10 J
work(PlanningPolicy(objective=Objective.MAKESPAN))
