"""The MCP server: gives an assistant the commands of antdsl and its documentation, within folders that the user grants.

A call comes in over standard input. `folders` turns its paths into absolute ones below a granted folder, `tools` runs the command
in a child process and returns what it prints, and `server` answers. Commands run in children because a simulation may be stopped
at any time, and because nothing but the protocol may reach standard output. `pages` searches the documentation.

The protocol is that of the Model Context Protocol; the package `mcp`, of the extra `[mcp]`, implements it."""
