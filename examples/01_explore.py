"""Three robots explore a depot; the run is recorded and can be repeated to the last byte."""

import sys
from pathlib import Path

from robrain import Scenario

recording = Path(sys.argv[1] if len(sys.argv) > 1 else "explore.mcap")
result = Scenario.builtin("depot").replace(robots=3, seed=7).run(until_explored=0.95, record=recording)
print(f"{result.explored_fraction:.0%} explored in {result.sim_time_s:.0f} s with {result.distance_m:.0f} m driven")
print(f"digest {result.digest[:16]}, recorded in {result.recording}")
