"""The table of topics, queries and tokens: who publishes what, under which key, how often."""
