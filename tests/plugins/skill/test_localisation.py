import math

from robrain.algorithms.localization.rssi_ranging import PathLoss, RssiSample
from robrain.algorithms.navigation.wheel_bases import OmniBase
from robrain.plugins.unit.snw_exploration.interface import RssiMeasurement
from robrain.protocol.can.frames import codec
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT
from robrain.protocol.model.geometry import Point2D, Twist2D
from robrain.protocol.model.map_frame import ARENA

BASE = OmniBase()
WHEELS = ("wheel_1_ticks", "wheel_2_ticks", "wheel_3_ticks")
MOTES = [Point2D(x, y) for x in (-2.0, 3.0, 9.0, 15.0) for y in (-5.0, 4.0)]


def biased(one, bus, metres, *, each=None):
    """Encoder frames of a robot that drives straight, and whose third wheel counts 2 % too much."""
    turns = BASE.wheel_speeds_rad_s(Twist2D(0.01))
    state = {"x_m": 0.0, "counts": [0.0, 0.0, 0.0], "frame": 0}
    for _ in range(round(metres / 0.01)):
        state["x_m"] += 0.01
        state["frame"] = (state["frame"] + 1) % 256
        for wheel, turn_rad in enumerate(turns):
            state["counts"][wheel] += turn_rad * (1.02 if wheel == 2 else 1.0) / BASE.rad_per_tick
        counts = [round(count) % 65536 for count in state["counts"]]
        frame = codec("WheelEncoders").pack(state["frame"], **dict(zip(WHEELS, counts, strict=True)))

        def tick(frame=frame):
            bus.send(frame)
            if each is not None:
                each(state["x_m"])

        one.run(0.02, tick)


def heard(one, host, x_m, step):
    """A mote's signal at a true place on the x axis, put where mote_ranges leaves it."""
    mote = MOTES[step % len(MOTES)]
    rssi_dbm = PathLoss().mean_dbm(math.hypot(x_m - mote.x_m, mote.y_m))
    host.board.mote_ranges.append(RssiSample(f"m{step % len(MOTES)}", mote, rssi_dbm))


def test_motes_correct_what_the_wheels_get_wrong(stage):
    errors_m = {}
    for motes in (False, True):
        one = stage()
        host = one.host("localisation", localisation={"motes": motes})
        steps = iter(range(1_000_000))

        def each(x_m, one=one, host=host, steps=steps):
            step = next(steps)
            if step % 10 == 0:
                heard(one, host, x_m, step // 10)

        biased(one, one.bus(), 12.0, each=each)
        pose = host.manager.get("localisation").plugin.pose()
        errors_m[motes] = math.hypot(pose.x_m - 12.0, pose.y_m)
        one.hosts.remove(host)
        host.close()
    assert errors_m[False] > 1.5
    assert errors_m[True] < 0.4 * errors_m[False]


def test_a_robot_whose_motes_contradict_its_wheels_says_that_it_is_lost_and_leaves_the_map_of_the_team(stage):
    one = stage()
    host = one.host("localisation", "mapper")
    lost = one.inbox(ROBOT_EVENT, robot="r1", plugin="localisation", event="diverged")
    patches = one.inbox(ROBOT_MAP)
    steps = iter(range(1_000_000))

    def each(x_m):
        step = next(steps)
        one.scan([0.0] * 90)
        if step % 5 == 0:
            heard(one, host, x_m + (9.0 if step > 200 else 0.0), step // 5)

    biased(one, one.bus(), 8.0, each=each)
    said = [received.message.value for received in lost.drain()]
    assert said[0]["is_lost"]
    assert said[0]["why"]
    frames = [received.message.frame for received in patches.drain()]
    assert frames[0] == ARENA
    assert frames[-1].robot == "r1"


def test_signals_reach_localisation_through_the_sensor_network(stage):
    one = stage()
    host = one.host("localisation", "mote_ranges", "snw_exploration")
    network = host.manager.get("snw_exploration").plugin
    for place in (Point2D(4.0, 0.0), None):
        network.measured.notify(RssiMeasurement(mote="m1", place=place, rssi_dbm=-78.0, stamp_ns=0))
    one.run(0.3)
    assert one.call("localisation", "health")["signals"] == 1
