"""Bytes that are no request, or a request that no browser sends; what a web server may do with them."""

from __future__ import annotations

import contextlib
import random
import socket
from collections.abc import Iterator

from hypothesis import strategies as st

ANSWER_S = 60.0  # for anything that must happen, on the slowest machine
DEEP = b"[" * 60_000


def requests(port: int, key: str) -> dict[str, bytes]:
    """By what is wrong with them. `key`: the first part of a path that may be asked for, or ""."""
    own = f"Host: 127.0.0.1:{port}\r\nOrigin: http://127.0.0.1:{port}\r\n"
    path = f"/{key}/" if key else "/"

    def post(length: str, body: bytes = b"{}", more: str = "", what: str = "record") -> bytes:
        return f"POST {path}{what} HTTP/1.1\r\n{own}{more}{length}\r\n\r\n".encode() + body

    def get(target: str, more: str = "") -> bytes:
        return f"GET {target} HTTP/1.1\r\n{own}{more}\r\n".encode("latin-1")

    return {
        "a length that is no number": post("Content-Length: abc"),
        "a length below zero": post("Content-Length: -1"),
        "a length of a hundred digits": post(f"Content-Length: {'9' * 100}"),
        "a length of 5000 digits": post(f"Content-Length: {'9' * 5000}"),
        "a length in other digits": post("Content-Length: \N{SUPERSCRIPT TWO}"),
        "two lengths": post("Content-Length: 2\r\nContent-Length: 3"),
        "no length": post("X: 1"),
        "a body in chunks": post("Transfer-Encoding: chunked", b"2\r\n{}\r\n0\r\n\r\n"),
        "a body that is deep": post(f"Content-Length: {len(DEEP)}", DEEP),
        "a body that is no UTF-8": post("Content-Length: 2", b"\xff\xfe"),
        "a body with a number of 5000 digits": post("Content-Length: 5000", b"9" * 5000),
        "a body with a key twice": post("Content-Length: 13", b'{"a":1,"a":2}'),
        "a file whose name no file may have": post("Content-Length: 1", b"x", what=f"take?name={'a' * 300}.csv"),
        "a file with a NUL in its name": post("Content-Length: 1", b"x", what="take?name=a%00.csv"),
        "a body behind a request to look": get(f"{path}state", "Content-Length: 30\r\n") + b"GET / HTTP/1.1\r\n\r\n",
        "a NUL in a path": get(f"{path}files/a\0b.html"),
        "an encoded NUL in a path": get(f"{path}files/a%00b.html"),
        "a path out of the directory": get(f"{path}files/%2e%2e/%2e%2e/etc/passwd.html"),
        "a name that no file may have": get(f"{path}files/{'a' * 5000}.html"),
        "a name that is no UTF-8": get(f"{path}files/%ff%fe.html"),
        "an address that is none": get("http://[::1/"),
        "another address that is none": get("//["),
        "a path of 100 kB": get(path + "a" * 100_000),
        "a header of 100 kB": get(path, f"X: {'a' * 100_000}\r\n"),
        "200 headers": get(path, "".join(f"X-{k}: 1\r\n" for k in range(200))),
        "two hosts": get(path, "Host: evil.example\r\n"),
        "no version": f"GET {path}\r\n".encode(),
        "a version that is none": f"GET {path} HTTP/a.b\r\n{own}\r\n".encode(),
        "HTTP/2": b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
        "an unknown method": f"BREW {path} HTTP/1.1\r\n{own}\r\n".encode(),
        "a proxy's method": f"CONNECT 127.0.0.1:{port} HTTP/1.1\r\n{own}\r\n".encode(),
        "TLS": b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + random.Random(1).randbytes(500),
        "an upgrade that is none": get(path + "live", "Upgrade: websocket\r\nConnection: Upgrade\r\n") + b"\x81\x82",
        "an empty line": b"\r\n",
        "nothing": b"",
    }


def raw_bytes(port: int, key: str) -> st.SearchStrategy[bytes]:
    """Requests with parts of them left out, doubled or replaced; and bytes of any kind."""
    whole = st.sampled_from([request for request in requests(port, key).values() if len(request) < 10_000])

    @st.composite
    def torn(draw: st.DrawFn) -> bytes:
        request = draw(whole)
        begin = draw(st.integers(0, len(request)))
        end = draw(st.integers(begin, min(len(request), begin + 200)))
        filling = draw(st.one_of(st.binary(max_size=40), st.sampled_from([b"\r\n", b"\r\n\r\n", b"\0", b":", b" "])))
        return request[:begin] + filling + request[end:]

    return st.one_of(torn(), st.binary(max_size=400))


def answered(port: int, sent: bytes) -> bytes:
    """What comes back on a connection that sends this and no more; b"" where it is closed without a word.

    Raises TimeoutError where neither happens.
    """
    with socket.create_connection(("127.0.0.1", port), timeout=ANSWER_S) as connection:
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # answered, and closed, before all was sent
            connection.sendall(sent)
            connection.shutdown(socket.SHUT_WR)
        return b"".join(_received(connection))


def _received(connection: socket.socket) -> Iterator[bytes]:
    with contextlib.suppress(ConnectionResetError):  # a server that drops a caller
        while part := connection.recv(1 << 16):
            yield part


def is_clean(answer: bytes) -> bool:
    """An answer of HTTP, or none."""
    return answer == b"" or answer.startswith((b"HTTP/1.1 ", b"HTTP/1.0 "))
