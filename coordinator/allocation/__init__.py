"""Allocation: who does which task, in which order, at what energy. Pure functions of what they are given; no wire."""
