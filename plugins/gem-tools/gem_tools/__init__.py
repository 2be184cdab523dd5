"""Tools for agents: Python in a sandbox, search, and any MCP server."""
