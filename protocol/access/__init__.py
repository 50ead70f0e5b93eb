"""Who may say, hear, ask and answer what: members of a secured team, their rights, and Zenoh's access rules."""
