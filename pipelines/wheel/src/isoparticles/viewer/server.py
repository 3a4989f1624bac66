"""Serves the page on one port of this computer.

Every path starts with a random token, and so does the path of the websocket, which the page derives
from its own address. Requests without the token are refused. Requests whose Host header names
another computer are refused as well: a web site whose name resolves to 127.0.0.1 (DNS rebinding)
must not reach the page.
"""

from __future__ import annotations

import asyncio
import hmac
import os
import secrets
import socket
import sys
from collections.abc import Awaitable, Callable
from typing import Any

from aiohttp import web

from isoparticles._errors import Error

ADDRESS = "127.0.0.1"
HOSTS = frozenset({"127.0.0.1", "localhost", "[::1]"})
"""Host names that a browser on this computer, or at the end of an SSH tunnel, uses."""
TOKEN_BYTES = 24
"""Bytes of the token. It is written in hexadecimal digits, because the client of trame turns
addresses into lower case."""
MAX_MESSAGE = 256 * 1024 * 1024
"""Maximum bytes of a websocket message. A surface of a million vertices takes about 60 MB."""
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


def guard(token: str) -> Any:
    """Return the middleware that refuses foreign requests."""

    @web.middleware
    async def check(request: web.Request, handler: Handler) -> web.StreamResponse:
        name = request.host.rsplit(":", 1)[0] if not request.host.endswith("]") else request.host
        if name.lower() not in HOSTS:
            raise web.HTTPForbidden(text="This page answers only to 127.0.0.1 and localhost.\n")
        first = request.path.split("/")[1]
        if not hmac.compare_digest(first.encode(), token.encode()):
            raise web.HTTPForbidden(text="The address lacks the token. Use the address that the program printed.\n")
        response = await handler(request)
        if not response.prepared:
            response.headers.update({"Referrer-Policy": "no-referrer", "X-Content-Type-Options": "nosniff"})
        return response

    return check


def listening(port: int) -> socket.socket:
    """Return a socket that listens on the port, or on a free port if it is 0.

    A browser that connects before the server runs waits for its answer.

    Raises
    ------
    Error
        If another program uses the port.
    """
    one = socket.socket()
    try:
        if sys.platform != "win32":
            # otherwise, the port of an ended page would stay in use for a minute
            one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        one.bind((ADDRESS, port))
        one.listen()
    except (OSError, OverflowError) as error:
        one.close()
        raise Error(
            f"port {port}: {error.strerror if isinstance(error, OSError) else 'not a port'}",
            "the page needs a port of its own",
            "leave out --port, or give a free one, such as --port 8765",
        ) from None
    return one


class PageServer:
    """A server of trame behind the guard."""

    def __init__(self, server: Any, port: int = 0, token: str | None = None) -> None:
        self.server = server
        self.token = token or secrets.token_hex(TOKEN_BYTES)
        self._socket = listening(port)
        self.port: int = self._socket.getsockname()[1]
        self._wslink: Any = None
        self._listener: asyncio.AbstractServer | None = None
        server.controller.on_server_bind.add(self._bind)
        server.controller.on_server_ready.add_task(self._listen)

    @property
    def address(self) -> str:
        """The address of the page, with the token."""
        return f"http://{ADDRESS}:{self.port}/{self.token}/index.html"

    def _bind(self, wslink: Any, **_: Any) -> None:
        """Move the routes of the page below the token."""
        inner, outer = wslink.app, web.Application(middlewares=[guard(self.token)])
        for route, folder in sorted(wslink.config["static"].items(), reverse=True):
            inner.router.add_static(f"/{route.strip('/')}", folder)
        inner.router.add_post("/paraview/", self._session)
        outer.add_subapp(f"/{self.token}/", inner)
        wslink.set_app(outer)
        self._wslink = wslink

    async def _listen(self, **_: Any) -> None:
        """Serve the socket of this page instead of the port that wslink has opened."""
        await self._wslink.site.stop()
        if self._socket.fileno() >= 0:
            # release() must find the listener before it watches the socket
            create = asyncio.get_running_loop().create_server
            self._listener = await create(self._wslink.runner.server, sock=self._socket, start_serving=False)
            await self._listener.start_serving()

    async def _session(self, request: web.Request) -> web.Response:
        """Answer the request of the client of trame for the address of the websocket."""
        return web.json_response({"sessionURL": f"ws://{request.host}/{self.token}/ws"})

    def start(self, exec_mode: str) -> Any:
        """Serve the page until the program is stopped (``main``), or in a task (``task``)."""
        # otherwise, trame would interpret the command line of this process as its own
        os.environ.setdefault("TRAME_ARGS", "--server")
        # otherwise, wslink would print a line for its launcher
        os.environ.setdefault("WSLINK_READY_MSG", "")
        self.server.options["ws_max_msg_size"] = MAX_MESSAGE
        if exec_mode == "main":
            asyncio.set_event_loop(asyncio.new_event_loop())
        return self.server.start(
            port=0,
            host=ADDRESS,
            timeout=0,
            open_browser=False,
            show_connection_info=False,
            disable_logging=True,
            exec_mode=exec_mode,
        )

    def release(self) -> None:
        """Close the port at once, and the idle connections."""
        if self._listener is not None:
            self._listener.close()
            # browsers would use them again for the next page at this port
            if self._wslink.runner.server is not None:
                self._wslink.runner.server.pre_shutdown()
        self._socket.close()

    async def stop(self) -> None:
        """Stop the server, even if it has not started completely."""
        await self.server.ready
        await self.server.stop()
