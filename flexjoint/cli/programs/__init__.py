"""Commands for other programs: tools over MCP, JSON schemas, and the benchmark for any tool."""
