"""The wire, described: JSON Schemas, and the documents made from the table of topics."""
