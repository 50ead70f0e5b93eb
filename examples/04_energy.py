"""Energy: a robot with a small battery patrols, charges before its energy is too low, and continues."""

from robrain import BatterySpec, ChargerSpec, RobotHardware, Scenario

POSTS = [(1.0, 1.0), (4.2, 3.0), (3.6, 4.8), (6.0, 3.0)]
battery = BatterySpec(capacity_wh=2.5, soc_at_start=0.5)  # some minutes
scenario = Scenario.builtin("arena_small").replace(
    robots=1, motes=0, seed=2, hardware=RobotHardware(battery=battery), chargers=(ChargerSpec(place_m=(0.6, 5.2)),)
)

with scenario.team() as team:
    team.run_for(30.0)  # it explores the floor
    activity = ""
    rounds, charges = 0, 0

    def patrol() -> bool:
        """Begin a new round when the last one is done; True once the robot has charged and is at its posts again."""
        global activity, rounds, charges
        if all(record.state.ended for record in team.list()):
            rounds += 1
            for number, post in enumerate(POSTS):
                team.submit("visit", id=f"round-{rounds}-post-{number}", place=post, service_s=5.0)
        state = team.state("r1")
        before, activity = activity, activity if state.behavior == "idle" else state.behavior  # between two tasks
        if activity != before and "recharge" in (activity, before) and state.battery is not None:
            charges += activity == "recharge"
            left = f"{state.battery.soc:.0%}, {state.battery.remaining_j:.0f} J left"
            print(f"{team.now_s:4.0f} s, round {rounds}: from {before or 'nothing'} to {activity}, {left}")
        return charges > 0 and activity == "visit"

    team.run_for(900.0, until=patrol)
    done = [record for record in team.list() if record.state == "done" and not record.own]
    print(f"{len(done)} posts in {rounds} rounds, {sum(record.result['energy_j'] for record in done):.0f} J for them")
