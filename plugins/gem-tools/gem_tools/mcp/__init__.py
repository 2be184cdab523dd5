"""The tool ``mcp``: what servers of the Model Context Protocol offer, as tools for agents."""
