"""Serving an application to browsers: with a token, and on this machine only unless asked."""

from __future__ import annotations

import hmac
import html
import ipaddress
import logging
import os
import secrets
import signal
import socket
import sys
import threading
import webbrowser
from collections.abc import Callable
from contextlib import suppress
from typing import Any
from urllib.parse import urlsplit

from ..runtime import checks
from ..runtime.progress import SIGNALS

LOOPBACK = "127.0.0.1"
FIRST_PORT, PORTS = 5006, 100
MAX_MESSAGE = 64 << 20
"""Largest message from a browser, such as a file [bytes]."""

ASK = """<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title>
<meta name="color-scheme" content="light dark"><body style="font: 16px system-ui; margin: 3em">
<h1 style="font-size: 1.2em">{title}</h1>
<p>This page needs the token that the command has printed with its address.</p>
<form action="/"><label>Token <input name="token" autofocus></label> <button>Open</button></form>"""


def require_panel() -> Any:
    """The package `panel`.

    Raises:
        RuntimeError: It is not installed; one line with the command that helps.
    """
    try:
        import panel
    except ImportError:
        raise RuntimeError(
            "panel is not installed; run: pip install 'tofrender[explore]'"
        ) from None
    return panel


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach an address.

    Example:
        >>> is_loopback("127.0.0.1"), is_loopback("localhost"), is_loopback("0.0.0.0")
        (True, True, False)
    """
    with suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return host == "localhost"


def serve(
    make: Callable[[], Any],
    title: str,
    *,
    host: str = LOOPBACK,
    port: int | None = None,
    browser: bool = False,
    tell: Callable[[str], Any] = print,
) -> None:
    """Serve an application until Ctrl-C, SIGTERM or SIGHUP.

    Args:
        make: Returns what a new reader of the page gets, an object of Panel.
        title: The page's title.
        host: Address to listen on. Readers need a random token, a part of the page's address.
        port: Port to listen on; by default the first free one from 5006 on.
        browser: Whether to open the page, if there is a screen.
        tell: Called with the line that says where the page is.

    Raises:
        ValueError: The address or the port cannot be used; one line.
        RuntimeError: Panel is not installed.
    """
    require_panel()
    checks.instance("host", host, str, "an address like 127.0.0.1")
    if port is not None:
        checks.integer("port", port, 1, 65535)
    token = secrets.token_urlsafe(16)
    for noisy in ("bokeh.server.views.ws", "tornado.access"):
        logging.getLogger(noisy).setLevel(logging.ERROR)
    server = _bind(make, title, host, port, token)
    ended = threading.Event()

    def end(*_: Any) -> None:
        if not ended.is_set():
            ended.set()
            server.io_loop.add_callback_from_signal(server.io_loop.stop)

    heard = [n for n in SIGNALS if n.name != "SIGHUP" or signal.getsignal(n) != signal.SIG_IGN]
    before = {number: signal.signal(number, end) for number in heard}
    url = _url(host, server.port, token)
    tell(f"{title}: {url}  (Ctrl-C ends it)")
    sys.stdout.flush()
    if browser and _has_screen():
        server.io_loop.call_later(0.1, webbrowser.open, url)
    server.io_loop.asyncio_loop.set_exception_handler(_let_readers_go)
    try:
        server.start()
        server.io_loop.start()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        server.stop(wait=False)


def _let_readers_go(loop: Any, context: dict[str, Any]) -> None:
    """Say nothing when a page is closed while something is sent to it; pass on all other errors."""
    from tornado.iostream import StreamClosedError
    from tornado.websocket import WebSocketClosedError

    if not isinstance(context.get("exception"), StreamClosedError | WebSocketClosedError):
        loop.default_exception_handler(context)


def _bind(make: Callable[[], Any], title: str, host: str, port: int | None, token: str) -> Any:
    """A server on the port asked for, or on the first that is free."""
    from panel.io.server import get_server

    any_port, reason = _try(host, 0) if host else (0, "it is empty")
    if reason:
        raise ValueError(f"host = {checks.quote(host)}: must be an address to listen on ({reason})")
    wanted = [port] if port is not None else [*range(FIRST_PORT, FIRST_PORT + PORTS), any_port]
    for each in wanted:
        free, reason = _try(host, each)
        if reason and port is not None:
            raise ValueError(f"port = {port}: must be free to listen on ({reason})")
        if reason:
            continue
        with suppress(OSError):  # Somebody was faster
            server = get_server(
                make,
                port=free,
                address=host,
                title=title,
                websocket_origin="*",  # `_restrict` compares them
                websocket_max_message_size=MAX_MESSAGE,
                auth_provider=_by_token(title, token),
            )
            _restrict(server, host)
            return server
    raise ValueError(f"host = {host!r}: has no free port")


def _restrict(server: Any, host: str) -> None:
    """Refuse requests that no page of ours makes, before any other handler sees them.

    Panel imports whatever Python module an address below /components/ names. A page of another
    site reaches a server of this machine under a name of its own (DNS rebinding), which then stands
    in `Host`; pages on other ports of this machine share its cookies.
    """
    from tornado.routing import Matcher, Rule
    from tornado.web import ErrorHandler

    class Refused(Matcher):
        def match(self, request: Any) -> dict[str, Any] | None:
            known = not is_loopback(host) or is_loopback(request.host_name.strip("[]"))
            origin = request.headers.get("Origin")
            same = origin is None or urlsplit(origin).netloc.lower() == request.host.lower()
            taken = known and same and not request.path.startswith("/components/")
            return None if taken else {}

    rule = Rule(Refused(), ErrorHandler, {"status_code": 403})
    server._tornado.default_router.rules.insert(0, rule)


def _try(host: str, port: int) -> tuple[int, str]:
    """A port that is free, and why it is not, "" if it is; for port 0 any."""
    try:
        with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as found:
            found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, int(os.name != "nt"))
            found.bind((host, port))
            return found.getsockname()[1], ""
    except (OSError, UnicodeError) as error:
        return port, getattr(error, "strerror", None) or str(error)


def _url(host: str, port: int, token: str) -> str:
    is_any = host in ("", "0.0.0.0", "::")
    name = socket.gethostname() if is_any else f"[{host}]" if ":" in host else host
    return f"http://{name}:{port}/?token={token}"


def _has_screen() -> bool:
    is_local = sys.platform in ("win32", "darwin") and "SSH_CONNECTION" not in os.environ
    return is_local or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _by_token(title: str, token: str) -> Any:
    """What lets in those who know the token, and remembers them by a cookie."""
    from bokeh.server.auth_provider import AuthProvider
    from tornado.web import RequestHandler

    cookie = f"tofrender-{secrets.token_hex(4)}"

    class Refusal(RequestHandler):
        def get(self) -> None:
            self.set_status(403)
            self.finish(ASK.format(title=html.escape(title)))

    class ByToken(AuthProvider):
        @property
        def get_user(self) -> Callable[[Any], str | None]:
            def user(handler: Any) -> str | None:
                kept = handler.get_cookie(cookie) or ""
                given = handler.get_argument("token", kept)
                if not hmac.compare_digest(given.encode(), token.encode()):
                    return None
                if not kept and handler.request.headers.get("Upgrade", "") == "":
                    handler.set_cookie(cookie, token, httponly=True, samesite="Strict")
                return "reader"

            return user

        @property
        def login_url(self) -> str:
            return "/login"

        @property
        def login_handler(self) -> type[RequestHandler]:
            return Refusal

    return ByToken()
