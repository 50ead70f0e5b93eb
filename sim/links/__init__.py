"""The radio by which robots and coordinator hear each other in a lockstep run: `[links]` of a scenario."""
