"""Experiments with robrain: sweeps, forks, soaks, benchmarks and reports; an extra that no robot needs."""
