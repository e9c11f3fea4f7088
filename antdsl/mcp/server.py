"""The MCP server. It registers the tools, reads calls from standard input, and writes answers to standard output."""

from __future__ import annotations

from mcp.server import MCPServer
from mcp.types import ToolAnnotations

from antdsl import __version__
from antdsl.mcp.tools import TOOLS, Tools

INSTRUCTIONS = (
    "antdsl simulates crowds of animals from programs (.ant) and scenes (.yaml). Write or change these files, then `check` them "
    "and follow its suggestions. `run` a scene, `render` a frame to see it, `test` its specs, and `explain` one agent. "
    "Look up the language with `docs`: start with the page `docs/card`."
)


def build_server(tools: Tools) -> MCPServer:
    """Return a server with all tools."""
    server = MCPServer("antdsl", version=__version__, instructions=INSTRUCTIONS, log_level="WARNING")
    for entry in TOOLS:
        name = entry.method.__name__
        hints = ToolAnnotations(read_only_hint=entry.is_reader, destructive_hint=False, open_world_hint=False)
        server.add_tool(getattr(tools, name), name=name, annotations=hints, structured_output=False)
    return server


def run_server(tools: Tools) -> None:
    """Answer calls until standard input ends or the assistant closes standard output. Raises OSError if writing fails."""
    failure = None
    try:
        build_server(tools).run()
    except* BrokenPipeError:
        pass
    except* OSError as group:
        failure = _find_first_error(group)
    if failure is not None:
        raise failure


def _find_first_error(group: BaseExceptionGroup[OSError]) -> OSError:
    """Return the first OSError in an exception group, which may contain other groups."""
    first = group.exceptions[0]
    return _find_first_error(first) if isinstance(first, BaseExceptionGroup) else first
