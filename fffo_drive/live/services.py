"""The services of the viewers: the methods of the control API, each request checked before anything is asked.

What only looks needs no key. Everything else needs one that gives its role, a stop, too: the protocol knows no origin
and no user, so that any page in a browser of this machine could ask. The daemon's log says which role asked.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from enum import Enum
from typing import Any, NamedTuple, Protocol

from pydantic import BaseModel, ValidationError

from ..documents import wrong_parameters
from ..roles import Role, may
from .foxglove_protocol import AdvertisedService
from .keys import Keys

PREFIX = "/fffo_drive/"
ENDING = ("stop", "disable", "quick_stop")
UNSERVED = ("subscribe", "schema")  # of the connection, or served as the services' own schemas
WHO = "who"  # parameter of every method that does more than look: on whose behalf
KEY = {"type": "string", "description": "what `fffo-drive scope --viewers` says"}


class ServiceMethod(Protocol):
    """A method of the control API."""

    @property
    def parameters(self) -> type[BaseModel]:
        """Its parameters as a record."""
        ...

    @property
    def role(self) -> Role:
        """That is needed for it."""
        ...

    @property
    def summary(self) -> str:
        """What it does."""
        ...


class RefusedCallError(Exception):
    """A call that is not let through, and why."""


class MethodKind(Enum):
    """What a method is for. All but looking needs a key."""

    LOOKS = 0
    ENDS = 1  # motion or torque
    COMMANDS = 2


class Request(NamedTuple):
    """A request that may be carried out."""

    method: str
    params: dict[str, Any]
    kind: MethodKind


class Services:
    """What may be asked for, and with what."""

    def __init__(self, methods: Mapping[str, ServiceMethod], keys: Keys) -> None:
        self._keys = keys
        self._methods = {name: method for name, method in methods.items() if name not in UNSERVED}
        self._schemas = {name: _schema(method) for name, method in self._methods.items()}
        self._names = dict(enumerate(self._methods, start=1))

    def offered(self) -> list[AdvertisedService]:
        """As they are advertised; their numbers are theirs for `checked`."""
        return [self._service(number, name) for number, name in self._names.items()]

    def _service(self, number: int, name: str) -> AdvertisedService:
        method = self._methods[name]
        request: dict[str, Any] = {**self._schemas[name], "description": method.summary}
        if self.kind(name) is not MethodKind.LOOKS:
            key_name = self._key_name(name)
            request["properties"] = {key_name: KEY, **request.get("properties", {})}
            request["required"] = [key_name, *request.get("required", [])]
        return AdvertisedService(number, PREFIX + name, f"fffo_drive/{name}", request, {"type": "object"})

    def checked(self, number: int, payload: bytes) -> Request:
        """The request in a payload: its key first, then its parameters. Raises RefusedCallError."""
        name = self._names.get(number)
        if name is None:
            raise RefusedCallError("no such service")
        given, needed = _given(payload), self._methods[name].role
        asker = self._keys.asker(given.pop(self._key_name(name), ""))
        commands = self.kind(name) is not MethodKind.LOOKS
        if asker is None and commands:
            text = f"{name} needs the key: give what `fffo-drive scope --viewers` says as `{self._key_name(name)}`"
            raise RefusedCallError(text)
        if asker is not None and not may(asker.role, needed):
            raise RefusedCallError(f"{name} needs the role {needed}, this key gives {asker.role}")
        if asker is not None and commands:
            given[WHO] = asker.text
        try:
            self._methods[name].parameters.model_validate_json(json.dumps(given), strict=True)
        except ValidationError as error:
            wrong = "; ".join(wrong_parameters(error, self._methods[name].parameters, given))
            known = ", ".join(self._schemas[name].get("properties", ())) or "none"
            raise RefusedCallError(f"{name}: {wrong} (parameters: {known})") from None
        return Request(name, given, self.kind(name))

    def _key_name(self, name: str) -> str:
        """What the key is called in a request: `set` has a parameter `key` of its own."""
        return "access_key" if "key" in self._schemas[name].get("properties", {}) else "key"

    def kind(self, name: str) -> MethodKind:
        """What it is for."""
        if name in ENDING:
            return MethodKind.ENDS
        return MethodKind.LOOKS if self._methods[name].role == "look" else MethodKind.COMMANDS


def _schema(method: ServiceMethod) -> dict[str, Any]:
    """Of its parameters, without that which the key decides."""
    schema = method.parameters.model_json_schema()
    schema.get("properties", {}).pop(WHO, None)
    return schema


def _given(payload: bytes) -> dict[str, Any]:
    """The parameters in a request; an empty one has none."""
    try:
        given = json.loads(payload or b"{}", parse_constant=_no_constant, object_pairs_hook=_once)
    except (ValueError, RecursionError):
        given = None
    if not isinstance(given, dict):
        raise RefusedCallError("a request is one JSON object with the parameters, each given once")
    return given


def _no_constant(name: str) -> Any:
    raise ValueError(name)


def _once(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) != len(pairs):
        raise ValueError("given twice")
    return content
