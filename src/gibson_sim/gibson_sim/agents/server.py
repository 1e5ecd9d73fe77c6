"""Serves the tools of a session by the Model Context Protocol on stdin and stdout; the only module that imports the MCP SDK."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import logging
import os
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from mcp import types
from mcp.server.lowlevel import Server
from mcp.server.stdio import stdio_server

from gibson_sim import __version__
from gibson_sim.agents.session import AgentSession, Answer
from gibson_sim.agents.tools import TOOLS, description, input_schema
from gibson_sim.errors import GibsonSimError
from gibson_sim.quoting import clipped

logger = logging.getLogger(__name__)
INSTRUCTIONS = (
    "Simulates indoor robots in photorealistic rooms with standard ROS 2 topics. Metres, radians, seconds; poses are in the frame `map`: x and y on "
    "the floor, z up. Begin with start_simulation; in stepped time nothing moves between two calls. get_image shows what a camera sees; "
    "view_top and view_follow show the robot from outside. An error names the value, what is allowed, and what to do."
)
_PROGRESS_S = 5.0
"""Period at which a client that asks for it is told that a call is still running, s of wall time."""
_MAX_WAITING = 32
"""Greatest number of calls that wait for their turn."""
_END_S = 45.0
"""Longest time for the simulation to end with the server, s of wall time; after that it is killed."""


def serve(session: AgentSession) -> None:
    """Serves until stdin ends, then closes the session."""
    # One thread for all calls, which lives to the end: child processes end with the thread that has started them.
    with ThreadPoolExecutor(max_workers=1, thread_name_prefix="session") as worker:
        try:
            asyncio.run(_serve(session, worker))
        finally:
            closing = worker.submit(session.close)
            with contextlib.suppress(TimeoutError):
                closing.result(timeout=_END_S)
            if not closing.done():
                os._exit(1)  # a call hangs


async def _serve(session: AgentSession, worker: ThreadPoolExecutor) -> None:
    calls = _Calls(session, worker)
    server: Server[Any] = Server(
        "gibson-sim", version=__version__, instructions=INSTRUCTIONS, on_list_tools=_list_tools, on_call_tool=calls.call
    )
    async with stdio_server() as (read_stream, write_stream):
        await server.run(read_stream, write_stream, server.create_initialization_options())


async def _list_tools(context: Any, parameters: Any) -> types.ListToolsResult:
    return types.ListToolsResult(
        tools=[
            types.Tool(
                name=name,
                description=description(tool),
                input_schema=input_schema(tool),
                annotations=types.ToolAnnotations(read_only_hint=not tool.changes, open_world_hint=False),
            )
            for name, tool in TOOLS.items()
        ]
    )


class _Calls:
    """Executes calls one after the other in the thread of the session."""

    def __init__(self, session: AgentSession, worker: ThreadPoolExecutor) -> None:
        self._session, self._worker, self._waiting = session, worker, 0

    async def call(self, context: Any, parameters: types.CallToolRequestParams) -> types.CallToolResult:
        """Executes a tool; errors are results of one line, so that the agent reads them."""
        if self._waiting >= _MAX_WAITING:
            return _failed(f"{self._waiting} calls wait already: send the next one after an answer")
        self._waiting += 1
        begin = time.monotonic()
        try:
            future = asyncio.wrap_future(self._worker.submit(self._execute, parameters.name, parameters.arguments or {}))
            while not (await asyncio.wait({future}, timeout=_PROGRESS_S))[0]:
                await context.session.report_progress(time.monotonic() - begin, message=f"{parameters.name} is running")
            return future.result()
        finally:
            self._waiting -= 1

    def _execute(self, name: str, arguments: dict[str, Any]) -> types.CallToolResult:
        try:
            return _succeeded(self._session.call(name, arguments))
        except GibsonSimError as error:
            return _failed(str(error))
        except Exception as error:  # a mistake of ours must not end the session
            logger.exception("%s failed", name)
            return _failed(clipped(f"{name} failed by a mistake of Gibson Sim: {type(error).__name__}: {error}", 500))


def _succeeded(answer: Answer) -> types.CallToolResult:
    content: list[Any] = [types.TextContent(text=answer.text)]
    if answer.png is not None:
        content.append(types.ImageContent(data=base64.b64encode(answer.png).decode(), mime_type="image/png"))
    return types.CallToolResult(content=content)


def _failed(text: str) -> types.CallToolResult:
    return types.CallToolResult(content=[types.TextContent(text=text)], is_error=True)
