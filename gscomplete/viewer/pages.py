"""Corrections to the answers of viser's web server for which viser has no option.

Conventions
-----------
* Only servers that start within :func:`mended_answers` are concerned.
* A machine's own names are ``localhost``, its host name, any IP address, and where it listens.
* A page that differs from the expected one, as in another version of viser, is served unchanged.
"""

from __future__ import annotations

import contextlib
import gzip
import inspect
import ipaddress
import socket
from collections.abc import Iterator
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

_UNPACKED = b"const code=td.decode(heap.subarray(up+ss,up+sz));"
"""Where the page has unpacked its script."""
_CORNERS = "new Float32Array([-2,-2,2,-2,2,2,-2,2]),2)"
"""The corners of a splat's square in that script: of two numbers each, so that three.js takes the
third for NaN and reports a radius of NaN when the pointer first moves over splats."""
_MENDED_CORNERS = "new Float32Array([-2,-2,0,2,-2,0,2,2,0,-2,2,0]),3)"


@contextlib.contextmanager
def mended_answers(listening_at: str) -> Iterator[None]:
    """Make servers that start in the block refuse other sites' requests and serve a mended page.

    A page of any site can open a WebSocket to this machine; its browser then names that site in the
    header Origin. A site can also make its own name resolve to this machine (DNS rebinding), so
    that Origin and Host agree, but then Host is not one of this machine's names. viser itself
    answers both kinds of request.

    Args:
        listening_at: host that the servers listen at.
    """
    from websockets.asyncio import server

    serve = server.serve

    def guarded(*arguments: Any, process_request: Any = None, **options: Any) -> Any:
        async def answer(connection: Any, request: Any) -> Any:
            origin, host = request.headers.get("Origin"), request.headers.get("Host")
            if host is not None and not is_own_name(host, listening_at):
                said = f"not a name of this machine: {host}; use its address\n"
                return connection.respond(HTTPStatus.FORBIDDEN, said)
            if origin is not None and urlsplit(origin).netloc != host:
                return connection.respond(HTTPStatus.FORBIDDEN, "another site's page\n")
            result = process_request(connection, request) if process_request else None
            return _mended(await result if inspect.isawaitable(result) else result)

        return serve(*arguments, process_request=answer, **options)

    server.serve = guarded  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        server.serve = serve  # type: ignore[misc]


def is_own_name(host: str, listening_at: str) -> bool:
    """Tell whether a request's Host, with or without a port, names this machine."""
    try:
        name = urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return False
    own = {"localhost", socket.gethostname().lower(), socket.getfqdn().lower(), listening_at}
    if name in own or name.endswith(".localhost"):
        return True
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def mended_page(page: bytes) -> bytes:
    """Return viser's page with splat corners of three numbers each, which make a square."""
    replaced = f'.replace("{_CORNERS}","{_MENDED_CORNERS}")'.encode()
    return page.replace(_UNPACKED, _UNPACKED[:-1] + replaced + b";")


def _mended(response: Any) -> Any:
    """Return the answer to a request with its page mended; None (a WebSocket) stays None."""
    if response is None or response.status_code != HTTPStatus.OK or not response.body:
        return response
    is_packed = response.headers.get("Content-Encoding") == "gzip"
    page = gzip.decompress(response.body) if is_packed else response.body
    mended = mended_page(page)
    if mended != page:
        response.body = gzip.compress(mended) if is_packed else mended
        del response.headers["Content-Length"]
        response.headers["Content-Length"] = str(len(response.body))
    return response
