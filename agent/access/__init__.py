"""Who may call a plugin and how: handles, access rules, exclusive use, external calls."""
