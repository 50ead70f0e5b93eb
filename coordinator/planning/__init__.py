"""Planning: requests to the allocators, and the use of their plans."""
