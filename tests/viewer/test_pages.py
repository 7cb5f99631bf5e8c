"""What the web server of the viewer answers."""

import gzip
import re
import socket
import urllib.error
import urllib.request

import pytest

from gscomplete.viewer.pages import is_own_name, mended_page
from tests.builders.commands import PATIENCE_S

_DIGITS = "".join(chr(c) for c in range(0x21, 0x7F) if chr(c) not in "\"&<>'`")


def unpacked_script(page: str) -> str:
    """The script in viser's page, as its loader unpacks it: base 88, then zstd."""
    zstandard = pytest.importorskip("zstandard")
    found = re.search(r'data-p="([^"]*)" data-ss="(\d+)" data-cs="(\d+)"', page)
    if found is None:
        pytest.skip("viser's page is packed in another way")
    value, packed = {digit: i for i, digit in enumerate(_DIGITS)}, bytearray()
    text, styles, script = found[1], int(found[2]), int(found[3])
    for start in range(0, len(text), 5):
        group = text[start : start + 5]
        number = 0
        for digit in group:
            number = number * 88 + value[digit]
        packed += number.to_bytes(len(group) - 1, "big")
    raw = zstandard.ZstdDecompressor().decompress(bytes(packed), max_output_size=styles + script)
    return raw[styles:].decode()


def viser_version() -> str:
    import viser

    return viser.__version__


@pytest.mark.parametrize(
    ("origin", "is_let_in"),
    [(None, True), ("http://127.0.0.1:{port}", True), ("http://evil.example", False)],
)
def test_a_page_of_another_site_is_not_let_in(viewer, origin, is_let_in):
    """Any page that a browser shows may open a WebSocket to this machine."""
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect

    port = viewer.server.get_port()
    chosen = origin and origin.format(port=port)
    address, version = f"ws://127.0.0.1:{port}", f"viser-v{viser_version()}"
    if is_let_in:
        with connect(address, origin=chosen, subprotocols=[version], max_size=None) as page:
            assert page.recv(timeout=PATIENCE_S)
    else:
        with pytest.raises(InvalidStatus, match="403"):
            connect(address, origin=chosen, subprotocols=[version])


def test_a_site_whose_name_resolves_to_this_machine_is_not_let_in(viewer):
    """Origin and Host agree once a site's name is rebound to this machine's address."""
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect

    port = viewer.server.get_port()
    rebound = f"evil.example:{port}"
    page = socket.create_connection(("127.0.0.1", port))
    with pytest.raises(InvalidStatus, match="403"):
        connect(
            f"ws://{rebound}",
            sock=page,
            origin=f"http://{rebound}",
            subprotocols=[f"viser-v{viser_version()}"],
        )
    request = urllib.request.Request(f"http://127.0.0.1:{port}", headers={"Host": rebound})
    with pytest.raises(urllib.error.HTTPError, match="403"):
        urllib.request.urlopen(request, timeout=PATIENCE_S)


@pytest.mark.parametrize(
    ("host", "is_own"),
    [
        ("localhost:8080", True),
        ("LOCALHOST", True),
        ("viewer.localhost:80", True),
        ("192.168.1.7:8080", True),
        ("[::1]:8080", True),
        (f"{socket.gethostname()}:8080", True),
        ("listening.example", True),
        ("evil.example:8080", False),
        ("127.0.0.1.evil.example", False),
        ("localhost.evil.example", False),
        ("[::1", False),
        ("", False),
    ],
)
def test_names_of_this_machine(host, is_own):
    assert is_own_name(host, "listening.example") == is_own


@pytest.mark.parametrize("encoding", ["identity", "gzip"])
def test_the_page_makes_corners_of_three_numbers(viewer, encoding):
    """Corners of two have NaN for a third: three.js reports a radius of NaN in the console."""
    address = f"http://127.0.0.1:{viewer.server.get_port()}"
    request = urllib.request.Request(address, headers={"Accept-Encoding": encoding})
    with urllib.request.urlopen(request, timeout=PATIENCE_S) as answer:
        assert answer.headers["Content-Encoding"] == encoding
        body = answer.read()
        assert len(body) == int(answer.headers["Content-Length"])
    page = (gzip.decompress(body) if encoding == "gzip" else body).decode()
    (old, new) = re.findall(r'\.replace\("(.+?)","(.+?)"\);', page)[0]
    if encoding == "identity":
        script = unpacked_script(page)
        assert script.count(old) == 1
        script = script.replace(old, new)
        (numbers, size) = re.findall(r"Float32Array\(\[(-2,-2,[^]]*)\]\),(\d)\)", script)[0]
        corners = [float(number) for number in numbers.split(",")]
        assert len(corners) == 4 * int(size) == 12
        assert corners[2::3] == [0.0] * 4


def test_another_page_is_served_as_it_is():
    assert mended_page(b"<html></html>") == b"<html></html>"
