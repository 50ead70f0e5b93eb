"""Plugins of all tests."""

pytest_plugins = ["tests.cpu_budget"]
