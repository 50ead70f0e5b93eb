"""Scenarios that come with robrain, one TOML file each."""
