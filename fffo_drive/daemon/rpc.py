"""JSON-RPC 2.0, one document a line: from bytes to calls, from results and errors to bytes. No sockets, no axis.

Every malformed request has its error: not JSON, no request, an empty or over-long batch, an unknown method, wrong
parameters. A request without `id` is a notification and is never answered, not even by an error.
"""

from __future__ import annotations

import json
from typing import Any, NamedTuple

from ..documents import as_json

PARSE_ERROR = -32700
INVALID_REQUEST = -32600
METHOD_NOT_FOUND = -32601
INVALID_PARAMS = -32602
INTERNAL_ERROR = -32603
# ours
REFUSED = -32000  # not possible in this state; data: state, allowed
READ_ONLY = -32001
DRIVE_ERROR = -32002
BAD_DOCUMENT = -32003  # a profile, model, key or file that cannot be used
NOT_REACHED = -32004  # requested state not reached in time; data: state
LIMIT = -32005  # line, batch, clients, send buffer

BATCH_LIMIT = 16
DEEPEST = 32  # of brackets; the parser recurses
TOO_DEEP = f"brackets deeper than {DEEPEST}"
MOST_VALUES = 10_000  # of a line, brackets and commas: 3000 points of a profile
LONGEST_NAME = 80  # characters of a key in a message
_ROUND = bytes.maketrans(b"[{]}", b"(())")
_NO_BRACKETS = bytes(set(range(256)) - set(b"[{]}"))

Json = Any
Id = str | int | float | None


class RpcError(Exception):
    """An error for the client."""

    def __init__(self, code: int, message: str, data: Json = None) -> None:
        super().__init__(message)
        self.code, self.message, self.data = code, message, data


class DuplicateKeyError(ValueError):
    """An object with a key twice."""


class NotANumberError(ValueError):
    """NaN or an infinity."""


class Call(NamedTuple):
    """One call; `id` is NOTIFICATION if no answer is expected."""

    id: Any
    method: str
    params: dict[str, Json]


NOTIFICATION = object()


class Document(NamedTuple):
    """A line: calls, and errors for invalid ones, in the order of the line."""

    items: list[Call | dict[str, Json]]
    batch: bool


def read_line(line: bytes) -> Document:
    """Parse one line. A document that is no JSON is one error."""
    refusal = _too_much(line)
    if refusal is not None:
        return Document([error_of(None, RpcError(PARSE_ERROR, refusal))], False)
    try:
        content = json.loads(line.decode("utf-8"), parse_constant=_no_constant, object_pairs_hook=_once)
    except UnicodeDecodeError as error:
        return Document([error_of(None, RpcError(PARSE_ERROR, f"not UTF-8 (byte {error.start})"))], False)
    except DuplicateKeyError as error:
        return Document([error_of(None, RpcError(INVALID_REQUEST, str(error)))], False)
    except json.JSONDecodeError as error:
        return Document(
            [error_of(None, RpcError(PARSE_ERROR, f"not JSON: {error.msg} (character {error.pos})"))], False
        )
    except NotANumberError as error:
        return Document([error_of(None, RpcError(PARSE_ERROR, f"not JSON: {error}"))], False)
    except ValueError:
        return Document([error_of(None, RpcError(PARSE_ERROR, "a number of too many digits"))], False)
    if not isinstance(content, list):
        return Document([_call(content)], False)
    if not 1 <= len(content) <= BATCH_LIMIT:
        text = f"a batch has 1 to {BATCH_LIMIT} requests, this one {len(content)}"
        return Document([error_of(None, RpcError(INVALID_REQUEST if not content else LIMIT, text))], False)
    return Document([_call(item) for item in content], True)


def _call(content: Json) -> Call | dict[str, Json]:
    if not isinstance(content, dict):
        return error_of(None, RpcError(INVALID_REQUEST, "a request is an object with jsonrpc, method, params, id"))
    number = content.get("id", NOTIFICATION)
    known = number is NOTIFICATION or number is None or isinstance(number, str | int | float)
    if not known or isinstance(number, bool):
        return error_of(None, RpcError(INVALID_REQUEST, "id: a string or a number"))
    name = content.get("method")
    answer_to = None if number is NOTIFICATION else number
    if content.get("jsonrpc") != "2.0":
        return error_of(answer_to, RpcError(INVALID_REQUEST, 'jsonrpc: "2.0" is needed'))
    if not isinstance(name, str):
        return error_of(answer_to, RpcError(INVALID_REQUEST, "method: a string is needed"))
    params = content.get("params", {})
    if not isinstance(params, dict):
        if isinstance(params, list) and not params:
            params = {}
        else:
            return error_of(answer_to, RpcError(INVALID_PARAMS, "params: an object with names is needed"))
    return Call(number, name, params)


def _too_much(line: bytes) -> str | None:
    """Why a line is rejected before parsing: too many values or too deep, counted conservatively (also inside strings).

    It takes a millisecond at most for any 260 kB; parsing that many values would take ten to seventy.
    """
    brackets = line.translate(_ROUND, _NO_BRACKETS)
    opened = brackets.count(b"(")
    if opened + line.count(b",") > MOST_VALUES:
        return f"more than {MOST_VALUES} values; give a long profile its name in the axis file (daemon.profiles)"
    if opened <= DEEPEST:
        return None
    for levels in range(DEEPEST + 1):  # each pass takes the innermost pairs of the whole line away
        fewer = brackets.replace(b"()", b"")
        if len(fewer) == len(brackets):  # what is left is never closed
            return None if levels + brackets.count(b"(") <= DEEPEST else TOO_DEEP
        brackets = fewer
    return TOO_DEEP


def _once(pairs: list[tuple[str, Json]]) -> dict[str, Json]:
    """An object. Raises ValueError for a duplicate key, which is ambiguous."""
    found: dict[str, Json] = {}
    for name, value in pairs:
        if name in found:
            raise DuplicateKeyError(f"{name[:LONGEST_NAME]!r} is given twice in one object")
        found[name] = value
    return found


def _no_constant(name: str) -> Json:
    raise NotANumberError(f"{name} is no JSON number")


def result_of(call: Call, result: Json) -> dict[str, Json]:
    """An answer."""
    return {"jsonrpc": "2.0", "id": call.id, "result": result}


def error_of(number: Id, error: RpcError) -> dict[str, Json]:
    """An answer that is an error."""
    content: dict[str, Json] = {"code": error.code, "message": error.message}
    if error.data is not None:
        content["data"] = error.data
    return {"jsonrpc": "2.0", "id": number, "error": content}


def notification(method: str, params: Json) -> dict[str, Json]:
    """A message that the server sends by itself."""
    return {"jsonrpc": "2.0", "method": method, "params": params}


def encode(content: Json) -> bytes:
    """One line. Numbers that JSON lacks become null."""
    try:
        return json.dumps(content, allow_nan=False, separators=(",", ":")).encode() + b"\n"
    except ValueError:
        return json.dumps(as_json(content), allow_nan=False, separators=(",", ":")).encode() + b"\n"
