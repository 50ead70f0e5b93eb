"""`robrain assistant`: an MCP server through which a language model looks at a team and asks it to work."""
