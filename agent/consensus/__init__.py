"""Tasks of robots while no coordinator is reachable."""
