"""Your own plugin, ten lines in the folder beside this file, loaded into a driving robot."""

from pathlib import Path

from robrain import Scenario

FOLDER = Path(__file__).with_name("03_your_own_plugin")

with Scenario.builtin("arena_small").replace(robots=1).team() as team:
    team.run_for(5.0)
    for info in team.load("r1", FOLDER):
        functions = ", ".join(function.name for function in info.functions)
        print(f"loaded {info.name}, a {info.level}: {functions}")
    for _ in range(3):
        team.run_for(5.0)
        print(f"{team.now_s:4.0f} s: r1 has come {team.call('r1', 'trip', 'distance_m')} m since")
