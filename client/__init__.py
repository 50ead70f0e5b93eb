"""The Python client of a team: `Team`, over a live or a lockstep transport."""
