"""The instances that allocators are measured by are also those that they are tested with."""

from robrain.lab.bench.allocation.instances import POWERS_W, SPEEDS_M_S, team_problem

__all__ = ["POWERS_W", "SPEEDS_M_S", "team_problem"]
