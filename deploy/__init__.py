"""Deployment of a team: commands, processes, certificates and supervision."""
