"""Planning: what is asked of the allocators, when, and what becomes of their plans."""
