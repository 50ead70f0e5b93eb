"""What if: a recorded lockstep run again up to a moment, and otherwise from there."""
