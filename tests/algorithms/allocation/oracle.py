"""The exact optimum, which tests and measurements compare with; see there for how it is written down."""

from robrain.lab.bench.allocation.exact import exact_plan

__all__ = ["exact_plan"]
