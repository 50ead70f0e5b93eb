"""Answers to queries, on threads and in lockstep."""
