"""Reading, checking and mending recordings."""
