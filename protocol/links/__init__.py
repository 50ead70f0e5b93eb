"""Carriers of puts, queries and tokens between endpoints."""
