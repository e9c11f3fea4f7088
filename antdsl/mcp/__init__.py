"""The MCP server: gives an assistant the commands of antdsl and its documentation, within folders that the user grants.

Calls arrive on standard input. `folders` turns their paths into absolute paths below a granted folder. `tools` runs the command
in a child process and returns its output, and `server` sends the answer. Commands run in child processes, because a simulation
may be stopped at any time. Also, only the protocol may be written to standard output. `pages` searches the documentation.

The package `mcp` implements the Model Context Protocol; the extra `[mcp]` installs it."""
