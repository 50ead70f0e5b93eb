"""A coordinator that stands by for another, with a copy of its journal."""
