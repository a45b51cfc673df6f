"""Serve an application to browsers, with a token, and by default on this machine only."""

import errno
import hmac
import html
import ipaddress
import logging
import os
import secrets
import signal
import socket
import sys
import webbrowser
from collections.abc import Callable
from contextlib import suppress
from string import Template
from typing import Any
from urllib.parse import urlsplit

from ...runtime import checks
from ...runtime.progress import SIGNALS
from .bundle import text_of

LOOPBACK = "127.0.0.1"
FIRST_PORT = 5006
PORTS = 100  # Number of ports that are tried
MAX_MESSAGE = 64 << 20  # Largest message from a browser, such as a file [bytes]


def require_panel() -> Any:
    """Import `panel`, or raise a RuntimeError with the command that installs it."""
    try:
        import panel
    except ImportError:
        raise RuntimeError(
            "panel is not installed; run: pip install 'tofrender[explore]'"
        ) from None
    return panel


def is_loopback(host: str) -> bool:
    """Return whether only this machine can reach an address."""
    with suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return host == "localhost"


def prepare(host: str, port: int | None) -> None:
    """Raise the errors of `serve` before long work: panel is missing, or the port is in use."""
    require_panel()
    checks.instance("host", host, str, "an address like 127.0.0.1")
    _probe(host, 0 if port is None else checks.integer("port", port, 1, 65535))


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

    `make` makes the page of a new reader. The address of the page has a random token and is passed
    to `tell`. By default the port is the first free port above 5005.
    """
    # Make the server
    prepare(host, port)
    token = secrets.token_urlsafe(16)
    for noisy in ("bokeh.server.util", "bokeh.server.views.ws", "tornado.access"):
        logging.getLogger(noisy).setLevel(logging.ERROR)
    server = _server(make, title, host, port or _free_port(host), token)

    def end(*_: Any) -> None:
        server.io_loop.add_callback_from_signal(server.io_loop.stop)

    # End at a signal
    handled = [n for n in SIGNALS if n.name != "SIGHUP" or signal.getsignal(n) != signal.SIG_IGN]
    before = {number: signal.signal(number, end) for number in handled}

    # Report the address, and open the browser
    url = _url(host, server.port, token)
    tell(f"{title}: {url}  (Ctrl-C ends it)")
    sys.stdout.flush()
    is_local = sys.platform in ("win32", "darwin") and "SSH_CONNECTION" not in os.environ
    if browser and (is_local or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        server.io_loop.call_later(0.1, webbrowser.open, url)

    # Serve until the end
    server.io_loop.asyncio_loop.set_exception_handler(_ignore_closed_pages)
    try:
        server.start()
        server.io_loop.start()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        server.stop(wait=False)


def _ignore_closed_pages(loop: Any, context: dict[str, Any]) -> None:
    """Ignore errors of pages that are closed while data are sent. Report all other errors."""
    from tornado.iostream import StreamClosedError
    from tornado.websocket import WebSocketClosedError

    if not isinstance(context.get("exception"), StreamClosedError | WebSocketClosedError):
        loop.default_exception_handler(context)


def _probe(host: str, port: int) -> None:
    """Raise a ValueError if the server cannot listen on an address or a port."""
    try:
        if not host:
            raise UnicodeError("it is empty")
        with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, int(os.name != "nt"))
            probe.bind((host, port))
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        if getattr(error, "errno", None) in (errno.EADDRINUSE, errno.EACCES):
            raise ValueError(f"port = {port}: must be free to listen on ({reason})") from None
        name = checks.quote(host)
        raise ValueError(f"host = {name}: must be an address to listen on ({reason})") from None


def _free_port(host: str) -> int:
    """Return the first free port, or 0, so that the system chooses a port."""
    for port in range(FIRST_PORT, FIRST_PORT + PORTS):
        with suppress(ValueError):
            _probe(host, port)
            return port
    return 0


def _server(make: Callable[[], Any], title: str, host: str, port: int, token: str) -> Any:
    """Return a server. All applications use the same document."""
    import panel as pn
    from panel.io.server import get_server

    def page() -> Any:
        document: Any = pn.state.curdoc
        style = text_of("explorer/page.css")
        document.template = Template(text_of("ui/page.html")).substitute(style=style)
        return make()

    server = get_server(
        page,
        port=port,
        address=host,
        title=title,
        location=False,  # Panel cannot read addresses of IPv6, and no page uses its location
        websocket_origin="*",  # `_restrict` compares origins
        websocket_max_message_size=MAX_MESSAGE,
        auth_provider=_token_provider(title, token),
    )
    _restrict(server, host)
    return server


def _restrict(server: Any, host: str) -> None:
    """Deny requests that the application's page never makes, before any other handler.

    Panel imports the Python module in an address below /components/. A page of another site can
    reach a server of this machine under the site's host name (DNS rebinding). Pages on other ports
    of this machine share the cookies of this server.
    """
    from tornado.routing import Matcher, Rule
    from tornado.web import ErrorHandler

    class Refused(Matcher):
        def match(self, request: Any) -> dict[str, Any] | None:
            # Host, origin and path must belong to the page
            known = not is_loopback(host) or is_loopback(request.host_name.strip("[]"))
            origin = request.headers.get("Origin")
            same = origin is None or urlsplit(origin).netloc.lower() == request.host.lower()
            allowed = known and same and not request.path.startswith("/components/")
            return None if allowed else {}

    rule = Rule(Refused(), ErrorHandler, {"status_code": 403})
    server._tornado.default_router.rules.insert(0, rule)


def _url(host: str, port: int, token: str) -> str:
    is_any = host in ("", "0.0.0.0", "::")
    name = socket.gethostname() if is_any else f"[{host}]" if ":" in host else host
    return f"http://{name}:{port}/?token={token}"


def _token_provider(title: str, token: str) -> Any:
    """Return the authentication of readers, by the token in the address, later by a cookie."""
    from bokeh.server.auth_provider import AuthProvider
    from tornado.web import RequestHandler

    cookie = f"tofrender-{secrets.token_hex(4)}"
    page = Template(text_of("ui/login.html")).substitute(title=html.escape(title))

    class Refusal(RequestHandler):
        def get(self) -> None:
            self.set_status(403)
            self.finish(page)

    def user(handler: Any) -> str | None:
        # The first request has the token, later requests have the cookie
        remembered = handler.get_cookie(cookie) or ""
        given = handler.get_argument("token", remembered)
        if not hmac.compare_digest(given.encode(), token.encode()):
            return None
        if not remembered and handler.request.headers.get("Upgrade", "") == "":
            handler.set_cookie(cookie, token, httponly=True, samesite="Strict")
        return "reader"

    class TokenProvider(AuthProvider):
        get_user = property(lambda _: user)
        login_url = property(lambda _: "/login")
        login_handler = property(lambda _: Refusal)

    return TokenProvider()
