"""The simulator: arena, firmware, motes, scenarios, and the lockstep drive."""
