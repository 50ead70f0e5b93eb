"""Reasons as data: one type for each, with a code and its subjects; `words` has their sentences."""
