"""A thousand agents, as `robrain bench agents` measures them; two numbers are how many, and for how many minutes."""

import sys

from robrain.deploy.bench_agents import MINUTES, ROBOTS, measure

__all__ = ["measure"]

if __name__ == "__main__":
    robots, minutes = [*sys.argv[1:], *(str(each) for each in (ROBOTS, MINUTES)[len(sys.argv) - 1 :])]
    for row in measure(int(robots), float(minutes)):
        words = (row.what, row.value, row.beside, row.bound, "yes" if row.is_kept else "no")
        sys.stdout.write(" | ".join(words) + "\n")
