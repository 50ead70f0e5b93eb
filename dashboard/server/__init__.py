"""The web server of the dashboard, and its connection to the team."""
