"""`make mutants`: tries a few hundred mutants of the code and lists those that no test detects."""

import argparse
import json
import os
import sys
import time
import tomllib
from pathlib import Path

import pytest

from tests.mutation.running import ROOT, MutationRun, Verdict
from tests.mutation.scope import PLACES, draw

LIVING = Path(__file__).parent / "living.toml"
BOUND = 0.9


def main() -> int:
    """Draw mutants, try them, print the result; 1 if fewer than nine in ten are killed."""
    options = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__)
    options.add_argument("places", nargs="*", default=list(PLACES), help="folders or files to mutate")
    options.add_argument("--count", type=int, default=400, help="how many mutants to draw (400)")
    options.add_argument("--seed", type=int, default=1, help="seed of the draw (1)")
    options.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="mutants tried at a time")
    options.add_argument("--tests", nargs="+", help="only these tests (those of each mutant's own folder)")
    options.add_argument("--reach", type=Path, help="keep here which functions each test reaches, for next time")
    options.add_argument("--json", type=Path, help="write each mutant and its fate to this file")
    asked = options.parse_args()

    os.environ["CI"] = "true"  # hypothesis then draws the same examples each time
    mutants = draw(ROOT, asked.count, asked.seed, tuple(asked.places))
    folders = sorted({f"tests/{mutant.path.split('/')[0]}" for mutant in mutants})
    begun = time.monotonic()

    def tell(text: str) -> None:
        print(f"{time.monotonic() - begun:6.0f} s  {text}", file=sys.stderr, flush=True)  # noqa: T201 (a command)

    run = MutationRun(mutants, asked.jobs, tell, asked.reach)
    quiet = ["-qq", "--no-header", "--no-summary", "--capture=no", "-p", "no:cacheprovider", "-o", "timeout=60"]
    pytest.main([*(asked.tests or folders), "-m", "not system", "-o", "addopts=--import-mode=importlib", *quiet], [run])
    return _report(run.verdicts, asked.json)


def _report(verdicts: list[Verdict], file: Path | None) -> int:
    judged = [verdict for verdict in verdicts if not verdict.why_no_verdict]
    living = sorted((verdict for verdict in judged if not verdict.killed_by), key=lambda verdict: verdict.mutant)
    reasons: dict[str, str] = tomllib.loads(LIVING.read_text()) if LIVING.exists() else {}
    if file is not None:
        rows = [
            {
                "name": verdict.mutant.name,
                "line": verdict.mutant.line,
                "killed_by": verdict.killed_by,
                "tests": verdict.tests,
                "seconds": round(verdict.seconds, 2),
                "not_tried": verdict.why_no_verdict,
            }
            for verdict in sorted(verdicts, key=lambda verdict: verdict.mutant)
        ]
        file.write_text(json.dumps(rows, indent=1))
    say = sys.stdout.write
    for verdict in living:
        why = reasons.get(verdict.mutant.name) or ("no test reaches it" if not verdict.tests else "no test fails")
        say(f"lives: {verdict.mutant.path}:{verdict.mutant.line} {verdict.mutant.function}: {verdict.mutant.change}\n")
        say(f"       {why}\n")
    if not judged:
        say("no mutant was judged\n")
        return 1
    share = 1 - len(living) / len(judged)
    say(f"{len(judged) - len(living)} of {len(judged)} mutants killed: {share:.1%} (bound {BOUND:.0%})\n")
    return 0 if share >= BOUND else 1


if __name__ == "__main__":
    sys.exit(main())
