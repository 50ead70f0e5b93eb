"""The sections of `make bench` in the order in which they run, deterministic ones first."""

from collections.abc import Callable, Iterable
from importlib import import_module
from typing import NamedTuple, cast

from robrain.lab.bench.figure import Figure


class Section(NamedTuple):
    """A group of figures that are measured together in one process."""

    title: str
    about: str
    """How the figures are measured."""
    measure: str
    """`module:function` that yields the figures."""


SECTIONS = {
    "exploration": Section(
        "Exploration",
        "Lockstep runs on the map of `examples/maps`.",
        "tests.bench.exploration:measure",
    ),
    "real_maps": Section(
        "Exploration of real maps",
        "Lockstep runs on the maps of `../shared/maps`.",
        "tests.bench.exploration:measure_real_maps",
    ),
    "exploration_lab": Section(
        "Exploration strategies",
        "`robrain bench exploration` with fidelity points until 95 % of the clinic are known. Seeds 51 and 52 "
        "chose nothing. One robot runs beside it with fidelity full. Figures are those of the default strategy.",
        "tests.bench.exploration_lab:measure",
    ),
    "traffic": Section(
        "Traffic",
        "`robrain bench traffic` with points, seed 1. LaCAM* (Okumura 2023) plans on the same floors for robots on a "
        "grid of 0.57 m without margins and delays. Each time that one of them reaches a place it plans again.",
        "tests.bench.traffic:measure",
    ),
    "zones": Section(
        "Zones",
        "Random zones on six floors with 1 to 8 robots as points, which explore and get tasks. Zones change twice.",
        "tests.bench.zones:measure",
    ),
    "motion": Section(
        "Motion on CAN",
        "True errors, by the arena. Squares as in UMBmark (Borenstein and Feng 1996), 8 seeds, in both directions.",
        "tests.bench.motion:measure",
    ),
    "energy": Section(
        "Battery and energy",
        "A hundred robots: capacity faded by 0 to 20 %, resistance grown by 0 to 60 %, 10 to 30 °C. Their payload is "
        "up to 4 kg, and their computers draw 4 to 9 W with bursts. Every second robot is found part-charged, and the "
        "cells differ from the nominal ones.",
        "tests.bench.energy:measure",
    ),
    "motes": Section(
        "Motes",
        "Lockstep runs in the built-in depot. The limit of a visit is a mote that sends all the time with the same "
        "shadowing, and repeats nothing unnecessarily.",
        "tests.bench.motes:measure",
    ),
    "localisation": Section(
        "Localisation",
        "20 × 20 m, 8 motes, 4 dB, 5 minutes, 50 seeds; each robot gets its start with an error. NEES, the mean of "
        "all runs, is 2 if the covariance is right. A run is lost in silence if the truth lies outside the 99.999 % "
        "ellipse for 10 s on end without a report. *Fresh seeds* were not used for choosing parameters; *the filter "
        "alone* knows the radio's true parameters.",
        "tests.bench.localisation:measure",
    ),
    "mapping": Section(
        "Mapping",
        "Floors of `examples/maps`, wheels that slip and are 1 % off, 1 % dropouts, seeds 1 and 2. Four robots map "
        "clinic and warehouse for 150 s, also with late messages and paused agents. Three robots in the clinic have "
        "unknown starts or are carried off. `robrain bench mapping` runs more.",
        "tests.bench.mapping:measure",
    ),
    "behaviors": Section(
        "Behaviors",
        "One robot in lockstep. Slipping wheels lose a twentieth of each turn, and 2 cm at random per metre.",
        "tests.bench.behaviors:measure",
    ),
    "planning": Section(
        "Planning",
        "Whole robots in lockstep in the explored depot, three sets of 12 tasks submitted at once; shares are means "
        "over the sets.",
        "tests.bench.planning:measure",
    ),
    "charging": Section(
        "Chargers",
        "Whole robots with batteries for some minutes, in lockstep.",
        "tests.bench.charging:measure",
    ),
    "allocation": Section(
        "Allocation",
        "Seconds of one core. Best known: searches of 60 and 120 s, `tests/bench/allocation_best.json`.",
        "tests.bench.allocation:measure",
    ),
    "consensus": Section(
        "Allocation without a coordinator",
        "Problems that its parameters were not chosen on (seeds 41 to 44), beside "
        "`optimal` with 1500 iterations. An exchange is one ballot of every robot.",
        "tests.bench.consensus:measure",
    ),
    "real_time_factor": Section(
        "Real-time factor",
        "Lockstep runs of 20 simulated seconds in the depot with 24 motes, one core, against the bare pymunk loop of "
        "the same world. The calibration loop tells how fast the machine is at the moment.",
        "tests.bench.real_time_factor:measure",
    ),
    "start": Section(
        "The start",
        "64 robots set up in the depot, the import of their plugins included. `robrain demo` in a fresh clone is "
        "opened by a running Chromium as soon as the address is printed. A picture has the colours of free floor and "
        "of robots. Cold is without byte code and compiled kernels.",
        "tests.bench.start:measure",
    ),
    "peers": Section(
        "Beside ir-sim",
        "ir-sim moves robots and their lidars alone, a step each turn of the lidar; robrain runs in the depot with "
        "everything on. Points drive in the hall of the soaks.",
        "tests.bench.peers:measure",
    ),
    "sweep": Section(
        "Sweeps",
        "`robrain sweep`: 30 runs of 60 simulated seconds in the depot, by one process and by two. The start of the "
        "processes and the figures are included.",
        "tests.bench.sweep:measure",
    ),
    "robot_cost": Section(
        "What a robot costs",
        "CPU per robot and simulated second: eight robots exploring the depot, all stock plugins, 15 s after a "
        "start of 3 s. The whole is that of an untouched run; the parts come from an equal run with timers.",
        "tests.bench.robot_cost:measure",
    ),
    "host_weight": Section(
        "The weight of an agent",
        "`robrain agent` in a separate process. It runs mocdevice, driver and command alone, or explores the depot "
        "with all stock plugins.",
        "tests.bench.host_weight:measure",
    ),
    "plugin_host": Section("The plugin host", "Live hosts on loopback.", "tests.bench.plugin_host:measure"),
    "tasks": Section("Tasks", "Wall time of one core.", "tests.bench.tasks:measure"),
    "live_planning": Section(
        "Plans beside the live coordinator",
        "Separate processes on loopback, compared with the same work on a thread.",
        "tests.bench.live_planning:measure",
    ),
    "recording": Section("Recordings", "CPU time.", "tests.bench.recording:measure"),
    "halt": Section(
        "Emergency halt",
        "From the put in one process to the stop frame on the CAN bus of a robot in another.",
        "tests.bench.halt:measure",
    ),
    "congestion": Section(
        "Busy network",
        "20 agents on loopback. Flooded: 20 MB/s to a reader and 2 MB/s to every robot by way of the hub. A reader of "
        "everything that hangs is stopped (SIGSTOP) while the flood goes on.",
        "tests.bench.congestion:measure",
    ),
    "deadman": Section(
        "Deadman",
        "The process that drives a robot by hand is killed or stopped: until the wheels' encoders stand. At 0.25 m/s a "
        "base needs 0.17 s to brake.",
        "tests.bench.deadman:measure",
    ),
    "secured_cost": Section(
        "Secured against plain",
        "Two teams of `arena_small` at the same time on one machine, one with certificates and a router's rules. "
        "Ratios of the latency of a call and of a state, and of the CPU of router and agent.",
        "tests.bench.secured_cost:measure",
    ),
    "responses": Section(
        "Response time",
        "From an event to the wheels, a live team of processes on loopback.",
        "tests.bench.responses:measure",
    ),
    "agents": Section(
        "A thousand agents",
        "Processes that stand in for agents, a real coordinator.",
        "tests.bench.agents:measure",
    ),
    "recovery": Section(
        "Recovery",
        "`robrain up` with two robots in `arena_small`, a stand-by, a recorder and a dashboard: each process in turn "
        "gets `kill -9`, then SIGSTOP. Noticed: `up` says that it has failed. Well again: another process of the team "
        "sees that it does its work.",
        "tests.bench.recovery:measure",
    ),
    "dashboard": Section(
        "Dashboard",
        "100 robots and 400 motes; browsers in software rendering share the cores with team and dashboard.",
        "tests.bench.dashboard:measure",
    ),
}
"""Sections by name."""


def function_of(name: str) -> Callable[[], Iterable[Figure]]:
    """Import and return the function that measures a section."""
    module, function = SECTIONS[name].measure.split(":")
    return cast(Callable[[], Iterable[Figure]], getattr(import_module(module), function))
