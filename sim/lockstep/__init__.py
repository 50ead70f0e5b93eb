"""The lockstep drive: many robots in one process, one step after the other."""
