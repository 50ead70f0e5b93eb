"""Motes: a robot fetches what a mote has stored; a reading is brought by whom it costs less: mote or robot."""

from collections import Counter

from robrain import Collect, LockstepTeam, Monitor, Scenario, Sense
from robrain.protocol.wire.reasons.robots import FarFromPlace

with LockstepTeam(Scenario.builtin("arena_small").replace(robots=2, motes=6, seed=4)) as team:
    motes = {mote.name: mote.place for mote in team.lockstep.world.motes}
    team.run_for(30.0)
    heard = Counter(reading.mote for reading in team.readings)
    print(f"after {team.now_s:.0f} s {len(heard)} of {len(motes)} motes were heard, {sum(heard.values())} readings")

    team.submit(Collect(id="mule", place=motes["m3"], mote="m3"))
    team.submit(Sense(id="warmth", place=motes["m1"], quantity="temperature_c"))
    team.submit(Sense(id="light", place=motes["m1"], quantity="light_lx"))
    team.submit(Monitor(id="watch", place=motes["m2"], duration_s=20.0, interval_s=2.0, quantity="temperature_c"))
    for record in team.wait("mule", "warmth", "light", "watch"):
        print(f"{record.task.id}: {record.state} by {record.robot}: {record.result}")

    for task in ("warmth", "light"):
        print(f"who is to do {task}?")
        for verdict in team.why(task).robots:
            if not isinstance(verdict.reason, FarFromPlace):
                print(f"  {verdict.robot}: {'chosen' if verdict.chosen else verdict.why_not}")
