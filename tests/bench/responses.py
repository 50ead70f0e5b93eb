"""Response time, as `robrain bench responses` measures it; a number is how many rounds."""

import sys

from robrain.deploy.bench_responses import ROUNDS, measure

__all__ = ["measure"]

if __name__ == "__main__":
    for row in measure(int(sys.argv[1]) if len(sys.argv) > 1 else ROUNDS):
        words = (row.what, row.value, row.beside, row.bound, "yes" if row.is_kept else "no")
        sys.stdout.write(" | ".join(words) + "\n")
        sys.stdout.flush()
