"""Planning objectives."""

from enum import StrEnum


class Objective(StrEnum):
    """Criteria that make one plan better than another."""

    ENERGY = "energy"
    """The least sum of joules and of the prizes that are not collected."""
    MAKESPAN = "makespan"
    """First the least prize lost, then the earliest time at which the last robot is back at its charger."""
    LIFETIME = "lifetime"
    """First the least prize lost, then the greatest energy left in the robot that has least left."""
