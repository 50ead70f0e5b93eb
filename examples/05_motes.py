"""Motes: a robot fetches stored readings of a mote; a reading is assigned to a mote or a robot, by cost."""

from collections import Counter

from robrain import Scenario

with Scenario.builtin("arena_small").replace(robots=2, motes=6).team(seed=4) as team:
    readings = list(team.readings(30.0))
    heard = Counter(reading.mote for reading in readings)
    print(f"after {team.now_s:.0f} s {len(heard)} of 6 motes were heard, {len(readings)} readings")
    places = {reading.mote: reading.place for reading in readings}

    team.submit("collect", id="mule", place=places["m3"], parameters={"mote": "m3"})
    team.submit("sense", id="warmth", place=places["m1"], parameters={"quantity": "temperature_c"})
    team.submit("sense", id="light", place=places["m1"], parameters={"quantity": "light_lx"})
    rounds = {"duration_s": 20.0, "interval_s": 2.0, "quantity": "temperature_c"}
    team.submit("monitor", id="watch", place=places["m2"], parameters=rounds)

    for task in ("warmth", "light"):
        print(f"who could do {task}?")
        for verdict in team.why(task).robots:
            if verdict.reason is None or verdict.reason.code != "far_from_place":
                print(f"  {verdict.robot}: {'chosen' if verdict.chosen else verdict.refusal or 'costs more'}")

    for record in team.wait_all(["mule", "warmth", "light", "watch"]):
        print(f"{record.task.id}: {record.state} by {record.robot}: {record.result}")
