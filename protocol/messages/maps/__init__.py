"""Messages about maps, and the packing of their patches."""
