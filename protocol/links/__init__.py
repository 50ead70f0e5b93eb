"""What carries puts, queries and tokens between endpoints."""
