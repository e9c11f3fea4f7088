"""The MCP server. It gives an assistant the commands of antdsl and its documentation, within folders that the user grants.

Calls arrive on standard input. `folders` converts their paths to absolute paths below a granted folder. `tools` runs a command
in a child process and returns its output, and `server` sends the answer. Child processes are used because a simulation may have
to be stopped, and because only messages of the protocol may be written to standard output. `pages` searches the documentation.

The package `mcp` implements the Model Context Protocol; the extra `[mcp]` installs it."""
