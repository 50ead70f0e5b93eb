"""Eight robots work in a warehouse by schedules, while zones change, doors fail and a robot is taken out of service.

python examples/11_fleet/fleet.py [SECONDS] [RECORDING]: two simulated hours if not given.
"""

import collections
import sys
from importlib import resources
from pathlib import Path

from robrain import Scenario, TaskState, Team, Zone, ZoneKind

SECONDS = float(sys.argv[1]) if len(sys.argv) > 1 else 7200.0
RECORDING = Path(sys.argv[2]) if len(sys.argv) > 2 else Path("fleet.mcap")
LATE_S = 300.0
"""An open task that is older is late."""
BLOCKED = Zone(name="works", kind=ZoneKind.KEEP_OUT, corners_m=((23.0, 11.3), (27.0, 11.3), (27.0, 13.5), (23.0, 13.5)))


def at(team: Team, share: float) -> None:
    """Let time pass until a share of the run; print late tasks with their reasons once a minute."""
    while (rest_s := share * SECONDS - team.now_s) > 0.0:
        team.run_for(min(60.0, rest_s))
        for record in team.list():
            age_s = team.now_s - record.submitted_ns / 1e9
            if not record.state.ended and age_s > LATE_S:
                print(f"{team.now_s:6.0f} s: {record.task.id} is {age_s:.0f} s old. {team.why(record).now}")


def main() -> None:
    """Run it, and print what became of each task."""
    warehouse = resources.files("robrain.sim.scenarios") / "warehouse.toml"
    toml = warehouse.read_text() + (Path(__file__).parent / "fleet.toml").read_text()
    with Scenario.from_toml(toml).replace(robots=8).team(seed=1, record=RECORDING) as team:
        at(team, 0.25)
        team.hold_robot("r3", reason="a wheel is loose", place="garage")
        at(team, 0.4)
        team.change_zones(BLOCKED)
        at(team, 0.5)
        team.release_robot("r3")
        at(team, 0.6)
        team.change_zones(remove=["works"])
        at(team, 1.0)
        team.change_rules(remove=[rule.name for rule in team.rules().rules])
        team.run_for(600.0, until=lambda: all(record.state.ended for record in team.list()))
        records = team.list()
        counts = collections.Counter((record.task.kind, record.state) for record in records)
        for (kind, state), count in sorted(counts.items()):
            print(f"{count:4} {kind:10} {state}")
        print(f"{sum(not record.state.ended for record in records)} of {len(records)} tasks are open")
        reasons = collections.Counter(record.why for record in records if record.state is TaskState.FAILED)
        for reason, count in reasons.most_common():
            print(f"{count:4} failed: {reason}")
        for state, count in collections.Counter(mission.state for mission in team.missions()).items():
            print(f"{count:4} missions {state}")


main()
