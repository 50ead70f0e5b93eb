"""Parts of a coordinator in one file each: charging, exploration, backups."""
