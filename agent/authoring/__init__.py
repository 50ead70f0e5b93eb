"""Tools for authors of plugins: skeleton, check, test bench."""
