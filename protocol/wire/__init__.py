"""The wire: topics, keys, messages, error codes, clocks, sessions and endpoints."""
