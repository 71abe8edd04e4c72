"""The server of the studio: on this computer only, its address known to whoever started it."""

from __future__ import annotations

import contextlib
import logging
import os
import secrets
import socket
import tempfile
import threading
import time
import webbrowser
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from orbitfinder.errors import InputError
from orbitfinder.studio.session import Session, opened, session_folder

HOST = "127.0.0.1"
PORT = 8642
TRIED = 20
"""Ports after the usual one that are tried where none is asked for"""
MOST_TABS = 8
"""Open at once; each has up to three processes of some 80 MB"""


def free_port(wanted: int | None = None) -> int:
    """The port that was asked for, or the first free one from the usual. Raises `InputError` where it is taken."""
    for port in (wanted,) if wanted is not None else range(PORT, PORT + TRIED):
        with socket.socket() as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                trial.bind((HOST, port))
            except OSError:
                continue
            return port
    if wanted is not None:
        raise InputError(
            f"port: {wanted} is in use, perhaps by a studio that runs already; leave it out and a free one is taken"
        )
    raise InputError(f"port: {PORT} to {PORT + TRIED - 1} are all in use; give another one")


class OwnOrigin:
    """Lets in what a page of ours asks for, and what no page does: another site's page names that as its origin."""

    def __init__(self, app: Any, port: int) -> None:
        self.app, self.origins = app, [None, *(f"http://{host}:{port}".encode() for host in (HOST, "localhost"))]

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Answer a request, or refuse it in a word."""
        if dict(scope.get("headers", ())).get(b"origin") in self.origins:
            await self.app(scope, receive, send)
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008})
        else:
            await send({"type": "http.response.start", "status": 403, "headers": []})
            await send({"type": "http.response.body", "body": b"another origin"})


def redirect(folder: Path, address: str) -> Path:
    """A file that only this user can read and that leads a browser to an address, which everybody could read among
    the arguments of the browser's process."""
    target = folder / "open.html"
    with open(os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as stream:
        stream.write(
            f'<!doctype html><meta http-equiv="refresh" content="0; url={address}"><a href="{address}">studio</a>'
        )
    return target


def brief(record: logging.LogRecord) -> logging.LogRecord:
    """What the server has to say in one printable line without a traceback: pages may send anything."""
    error = "" if not record.exc_info or record.exc_info[1] is None else f": {record.exc_info[1]!r}"
    record.msg, record.args, record.exc_info = ascii(f"{record.getMessage()}{error}")[1:-1][:300], (), None
    return record


def serve(file: Path | None, out: Path, port: int | None, browser: bool, announce: Callable[[str], None]) -> None:
    """Serve the studio until Ctrl-C; `announce` gets its address once. Raises `InputError`."""
    origin, chosen, token = opened(file), free_port(port), secrets.token_urlsafe(18)
    try:
        from nicegui import app, ui  # noqa: PLC0415  an extra
        from starlette.middleware.trustedhost import TrustedHostMiddleware  # noqa: PLC0415
        from starlette.responses import PlainTextResponse  # noqa: PLC0415
    except ImportError as error:
        raise InputError("studio: needs NiceGUI; pip install 'orbitfinder[studio]'") from error
    from orbitfinder.studio.page import ASSETS, SITE, Page  # noqa: PLC0415

    taken: set[str] = set()
    tabs: set[str] = set()
    made = logging.getLogRecordFactory()
    logging.setLogRecordFactory(lambda *given, **named: brief(made(*given, **named)))
    app.add_exception_handler(404, lambda *_: PlainTextResponse("not found", 404))
    app.add_middleware(OwnOrigin, port=chosen)
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=[HOST, "localhost"])
    app.add_static_files(f"/{token}/studio", ASSETS)
    app.add_static_files(f"/{token}/site", SITE)
    with (
        tempfile.TemporaryDirectory(prefix="orbitfinder-studio-", ignore_cleanup_errors=True) as folder,
        session_folder(out, origin.word) as kept,
    ):
        first = Session(origin, kept, out)
        first.restore()

        async def tab() -> None:
            if len(tabs) >= MOST_TABS:
                ui.label(f"{MOST_TABS} tabs of this studio are open, each with processes of its own; close one "
                         "and load this page again a minute later")  # fmt: skip
                return
            client = ui.context.client
            tabs.add(client.id)
            client.on_delete(lambda: tabs.discard(client.id))
            await Page(replace(first, energy=None), taken, f"/{token}").built()

        ui.page(f"/{token}")(tab)
        address = f"http://{HOST}:{chosen}/{token}"

        def ready() -> None:
            until = time.monotonic() + 120.0  # s, however busy the computer is
            while time.monotonic() < until:
                with contextlib.suppress(OSError):
                    socket.create_connection((HOST, chosen), 1.0).close()
                    break
                time.sleep(0.02)
            else:
                return
            announce(address)
            if browser:
                webbrowser.open(redirect(Path(folder), address).as_uri())

        app.on_startup(lambda: threading.Thread(target=ready, daemon=True).start())
        ui.run(
            host=HOST, port=chosen, show=False, reload=False, show_welcome_message=False, reconnect_timeout=60.0,
            title="orbitfinder studio", favicon=SITE / "icon.svg", language="en-US", limit_concurrency=400,
        )  # fmt: skip
