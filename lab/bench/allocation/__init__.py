"""How good the routes of the allocators are."""
