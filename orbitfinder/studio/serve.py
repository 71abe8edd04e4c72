"""The server of the studio: on this computer only, its address known to whoever started it."""

from __future__ import annotations

import secrets
import socket
import tempfile
import threading
import time
import webbrowser
from collections.abc import Callable
from pathlib import Path

from orbitfinder.errors import InputError
from orbitfinder.studio.session import Session, opened

HOST = "127.0.0.1"
PORT = 8642
TRIED = 20
"""Ports after the usual one that are tried where none is asked for"""
PATIENCE = 120.0
"""s in which the server begins to listen, however busy the computer is"""
RECONNECT = 60.0
"""s that a tab may be away"""


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


def _listens(port: int) -> bool:
    """Whether the server answers, after waiting for it."""
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until:
        try:
            socket.create_connection((HOST, port), 1.0).close()
        except OSError:
            time.sleep(0.02)
        else:
            return True
    return False


def serve(file: Path | None, out: Path, port: int | None, browser: bool, announce: Callable[[str], None]) -> None:
    """Serve the studio until Ctrl-C; `announce` gets its address once. Raises `InputError`."""
    origin, chosen, token = opened(file), free_port(port), secrets.token_urlsafe(18)
    try:
        from nicegui import app, ui  # noqa: PLC0415  an extra
        from starlette.middleware.trustedhost import TrustedHostMiddleware  # noqa: PLC0415
    except ImportError as error:
        raise InputError("studio: needs NiceGUI; pip install 'orbitfinder[studio]'") from error
    from orbitfinder.studio.page import ASSETS, SITE, Page  # noqa: PLC0415

    taken: set[str] = set()
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=[HOST, "localhost"])
    app.add_static_files(f"/{token}/studio", ASSETS)
    app.add_static_files(f"/{token}/site", SITE)
    with tempfile.TemporaryDirectory(prefix="orbitfinder-studio-", ignore_cleanup_errors=True) as folder:

        async def tab() -> None:
            own = Path(tempfile.mkdtemp(dir=folder))
            await Page(Session(origin, own, out), taken, f"/{token}").built()

        ui.page(f"/{token}")(tab)
        address = f"http://{HOST}:{chosen}/{token}"

        def ready() -> None:
            if _listens(chosen):
                announce(address)
                if browser:
                    webbrowser.open(address)

        app.on_startup(lambda: threading.Thread(target=ready, daemon=True).start())
        ui.run(
            host=HOST, port=chosen, show=False, reload=False, show_welcome_message=False, reconnect_timeout=RECONNECT,
            title="orbitfinder studio", favicon=SITE / "icon.svg", language="en-US",
        )  # fmt: skip
