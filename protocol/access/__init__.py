"""Rights on the wire: members of a secured team, their permissions to send and receive, and Zenoh's access rules."""
