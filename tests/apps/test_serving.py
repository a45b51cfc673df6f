"""Pages are served with a token, by default on this machine only; ports are free afterwards."""

import asyncio
import re
import socket
import sys
import time
import urllib.error
import urllib.request

import pytest
from bokeh.util.token import generate_jwt_token, generate_session_id
from helpers.limits import lower
from helpers.served import is_free, served
from tornado.iostream import StreamClosedError
from tornado.websocket import WebSocketClosedError

from tofrender.apps.ui import serving
from tofrender.apps.view.film_sources import LiveRender
from tofrender.cli import options
from tofrender.cli.app import main


def fetch(url: str, **headers: str) -> tuple[int, str]:
    try:
        asked = urllib.request.Request(url, headers=headers)
        with urllib.request.urlopen(asked) as got:
            return got.status, got.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


def is_open(url: str, *, origin: str | None = None) -> bool:
    found = re.fullmatch(r"http://([\w.]+|\[[\w:]+\]):(\d+)/(\?.*)?", url)
    host, port, query = found[1], int(found[2]), found[3] or ""
    lines = [
        f"GET /ws{query} HTTP/1.1",
        f"Host: {host}:{port}",
        f"Origin: {origin or f'http://{host}:{port}'}",
        "Connection: Upgrade",
        "Upgrade: websocket",
        "Sec-WebSocket-Version: 13",
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
        f"Sec-WebSocket-Protocol: bokeh, {generate_jwt_token(generate_session_id())}",
    ]
    with socket.create_connection((host.strip("[]"), port)) as there:
        there.sendall("\r\n".join([*lines, "", ""]).encode())
        return b" 101 " in there.recv(4096).split(b"\r\n")[0]


def has_ipv6() -> bool:
    try:
        with socket.socket(socket.AF_INET6) as probe:
            probe.bind(("::1", 0))
    except OSError:
        return False
    return True


def viewer(*options: str):
    return served("warptest", "no_op", "--no-browser", *options)


def test_two_viewers_find_two_ports_which_are_free_after_ctrl_c():
    with viewer() as one, viewer() as two:
        assert one.port != two.port
        assert one.url.startswith("http://127.0.0.1:")
        for each in (one, two):
            assert fetch(each.url)[0] == 200
            assert is_open(each.url)
            assert not is_open(each.url, origin="http://evil.example")
            base = each.site
            assert fetch(base)[0] == 403
            assert not is_open(base)
            assert fetch(each.url, Host=f"localhost:{each.port}")[0] == 200
            assert fetch(each.url, Host=f"evil.example:{each.port}")[0] == 403
            assert fetch(f"{base}components/antigravity/x/_css/y")[0] == 403
            assert each.stop() == 0
            assert "Traceback" not in each.errors
            assert is_free(each.port)


def test_a_port_that_is_taken_is_told_before_anything_is_loaded(capfd, monkeypatch):
    monkeypatch.setattr(options, "activate", None)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        for command in (["warptest", "no_op"], ["compare"], ["view", "cornell_box", "--live"]):
            assert main([*command, "--no-browser", "--port", port]) == 2
            said = capfd.readouterr().err
            assert said.startswith(f"error: --port = {port}: must be free to listen on")
            assert said.count("\n") == 1


def test_other_addresses_need_the_token():
    with viewer("--host", "0.0.0.0") as one:
        base, _, token = one.url.partition("?token=")
        base = f"http://127.0.0.1:{one.port}/"
        assert len(token) > 15
        for url in (base, f"{base}?token=wrong", f"{base}?token="):
            status, said = fetch(url)
            assert status == 403
            assert "needs the token" in said
            assert token not in said
            assert not is_open(url)
        assert fetch(f"{base}autoload.js?bokeh-autoload-element=1")[0] == 403
        status, said = fetch(f"{base}?token={token}")
        assert status == 200
        assert "Warp tester" in said
        assert is_open(f"{base}?token={token}")
        assert one.stop() == 0


@pytest.mark.skipif(not has_ipv6(), reason="this machine has no address ::1")
def test_an_address_of_ipv6():
    with viewer("--host", "::1") as one:
        assert one.url.startswith("http://[::1]:")
        status, said = fetch(one.url)
        assert status == 200
        assert "Warp tester" in said
        assert is_open(one.url)
        assert not is_open(one.url, origin="http://evil.example")
        assert fetch(one.url, Host=f"evil.example:{one.port}")[0] == 403
        assert one.stop() == 0
        assert "Traceback" not in one.errors


def test_addresses():
    assert serving.is_loopback("127.0.0.1")
    assert serving.is_loopback("::1")
    assert not serving.is_loopback("192.168.0.1")
    assert not serving.is_loopback("example.org")
    assert serving._url("::1", 5006, "abc") == "http://[::1]:5006/?token=abc"
    assert serving._url("10.0.0.1", 5006, "abc") == "http://10.0.0.1:5006/?token=abc"


def test_readers_may_go_while_something_is_sent_to_them(caplog):
    loop = asyncio.new_event_loop()
    loop.set_exception_handler(serving._ignore_closed_pages)
    for error in (StreamClosedError(), WebSocketClosedError()):
        loop.call_exception_handler({"message": "never retrieved", "exception": error})
    assert caplog.text == ""
    loop.call_exception_handler({"message": "never retrieved", "exception": KeyError("lost")})
    assert "lost" in caplog.text
    loop.close()


def test_what_panel_keeps_of_quick_changes_is_written(monkeypatch):
    from tofrender.apps.ui import page  # Imports Panel, which takes seconds

    written = []
    monkeypatch.setattr(page, "schedule_write_events", lambda *events: written.append(events))
    lower(monkeypatch, page_written_s=0)

    class Silent(page.App):
        _esm = "export function render() {}"

    async def change(document) -> None:
        app = Silent(None)
        app._document = document
        app.tell(message="one")
        app.tell(message="one")  # No change
        await asyncio.sleep(0.01)
        assert app.state == {"message": "one"}

    asyncio.run(change(None))
    assert written == []
    asyncio.run(change("a document"))
    assert written == [("a document", [], [])]


def test_without_panel_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "panel", None)
    with pytest.raises(RuntimeError, match=r"run: pip install 'tofrender\[explore\]'"):
        serving.require_panel()


def test_a_live_render_ends_at_its_samples():
    live = LiveRender("box", {"scene": "cornell_box", "size": (2, 2), "bins": 2, "spp": 3})
    live.start()
    live._thread.join()
    assert live.error is None
    assert live.spp == 3


def test_a_click_has_priority_over_the_next_step_of_a_render():
    """Only the step that runs at the click may end while the paths are traced."""
    live = LiveRender("box", {"scene": "cornell_box", "size": (2, 2), "bins": 2, "spp": 1 << 20})
    versions = []

    def trace_slowly(pixel, opl):
        end = time.monotonic() + 5
        while time.monotonic() < end and len(set(versions)) < 3:
            versions.append(live.version)
            time.sleep(0.01)
        return {"paths": []}

    vars(live)["_trace"] = trace_slowly
    live.start()
    while live.version < 1:
        time.sleep(0.01)
    live.trace([1, 1], [3.0, 6.0])
    live.close()
    assert len(set(versions)) <= 2
    assert live.error is None
