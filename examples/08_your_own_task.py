"""A kind of task of your own, defined only by the plugin in the folder beside this file."""

from pathlib import Path

from robrain import CallError, Scenario

FOLDER = Path(__file__).with_name("08_your_own_task")

with Scenario.builtin("arena_small").replace(robots=2).team() as team:
    team.run_for(20.0)
    team.load("r1", FOLDER)
    team.run_for(2.0)  # the coordinator queries r1 for its new kinds of task
    (mow,) = [known for known in team.kinds() if known.kind == "mow"]
    print(f"{', '.join(mow.robots)} can {mow.kind}: {', '.join(mow.parameters['properties'])}")

    try:
        team.submit("mow", place=(3.0, 3.0), parameters={"width_m": -1.0, "height_m": 1.0})
    except CallError as refused:
        print(refused)

    task = team.submit("mow", place=(3.0, 3.0), parameters={"width_m": 1.5, "height_m": 0.8})
    team.run_for(1.0)
    for verdict in team.why(task).robots:
        print(f"{verdict.robot}: {f'{verdict.energy_j:.0f} J' if verdict.energy_j else verdict.refusal}")
    done = team.wait(task)
    print(f"{done.task.id} {done.state} by {done.robot}: {done.result}")
