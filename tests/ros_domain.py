"""A ROS domain for one test."""

import random
import socket

FIRST_PORT, PORTS_A_DOMAIN, DOMAINS = 7400, 250, 100


class Domain:
    """A ROS domain that no other test process has: the number of a port that only one of them can bind."""

    def __init__(self) -> None:
        for domain_id in random.SystemRandom().sample(range(1, DOMAINS + 1), DOMAINS):
            self._held = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
            try:
                self._held.bind(("127.0.0.1", FIRST_PORT + PORTS_A_DOMAIN * domain_id))
            except OSError:
                self._held.close()
                continue
            self.id = domain_id
            return
        raise AssertionError("all ROS domains are taken by other tests")

    @property
    def variables(self) -> dict[str, str]:
        """Environment of a ROS 2 process that reaches nobody else."""
        return {
            "ROS_DOMAIN_ID": str(self.id),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_LOCALHOST_ONLY": "1",
        }

    def close(self) -> None:
        """Leave it to others."""
        self._held.close()
