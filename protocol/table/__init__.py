"""The table of topics, queries and tokens: publisher, message, key and rate of each."""
