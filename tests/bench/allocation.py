"""Allocation, as `robrain bench allocation` measures it.

`python -m tests.bench.allocation best` looks for better plans of the large instances, two minutes of a core each. It
writes them into `deploy/bench/allocation_best.json`; figures of ours are compared with what stands there.
"""

import sys

from rich.console import Console

from robrain.deploy.bench.allocation import find_best, measure
from robrain.deploy.bench.figure import WIDTH, show_figures

__all__ = ["measure"]

if __name__ == "__main__":
    if sys.argv[1:2] == ["best"]:
        find_best(tuple(int(seed) for seed in sys.argv[2:]) or (11,))
    else:
        show_figures("Allocation", measure(), Console(width=WIDTH))
