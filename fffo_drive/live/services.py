"""The services of the viewers: the methods of the control API, each request checked before the daemon is asked.

Methods that only read need no key. All others need one that gives their role, even a stop: the protocol has neither
origin nor user, so any page in a browser on this machine could call them. The daemon's log names the role.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from enum import Enum
from typing import Any, NamedTuple, Protocol

from pydantic import BaseModel, ValidationError

from ..documents import json_object, wrong_parameters
from ..roles import Role, may
from .foxglove_protocol import AdvertisedService
from .keys import Keys

PREFIX = "/fffo_drive/"
UNSERVED = ("subscribe", "schema")  # provided by the connection, or served as schemas of the services
WHO = "who"  # on whose behalf: a parameter of every method that does more than read
KEY = {"type": "string", "description": "the key that `fffo-drive scope --viewers` prints"}


class ServiceMethod(Protocol):
    """A method of the control API."""

    @property
    def parameters(self) -> type[BaseModel]:
        """Its parameters as a record."""
        ...

    @property
    def role(self) -> Role:
        """The role that it needs."""
        ...

    @property
    def summary(self) -> str:
        """Its description."""
        ...


class RefusedCallError(Exception):
    """A call that is refused; the text says why."""


class MethodKind(Enum):
    """The kind of a method. All kinds except looking need a key."""

    LOOKS = 0
    ENDS = 1  # motion or torque
    COMMANDS = 2


class Request(NamedTuple):
    """A request that may be carried out."""

    method: str
    params: dict[str, Any]
    kind: MethodKind


class Services:
    """The services, and the checks of a request."""

    def __init__(self, methods: Mapping[str, ServiceMethod], keys: Keys) -> None:
        self._keys = keys
        self._methods = {name: method for name, method in methods.items() if name not in UNSERVED}
        self._schemas = {name: _schema(method) for name, method in self._methods.items()}
        self._names = dict(enumerate(self._methods, start=1))

    def offered(self) -> list[AdvertisedService]:
        """The services to advertise; `checked` knows them by number."""
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
        """Decode and check a request: its key first, then its parameters. Raises RefusedCallError."""
        name = self._names.get(number)
        if name is None:
            raise RefusedCallError("no such service")
        given, needed = _given(payload), self._methods[name].role
        asker = self._keys.asker(given.pop(self._key_name(name), ""))
        commands = self.kind(name) is not MethodKind.LOOKS
        if asker is None and commands:
            text = f"{name} needs the key that `fffo-drive scope --viewers` prints, as `{self._key_name(name)}`"
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
        """Name of the key in a request: `set` has a parameter called `key`."""
        return "access_key" if "key" in self._schemas[name].get("properties", {}) else "key"

    def kind(self, name: str) -> MethodKind:
        """What it is for."""
        return {"look": MethodKind.LOOKS, "stop": MethodKind.ENDS}.get(self._methods[name].role, MethodKind.COMMANDS)


def _schema(method: ServiceMethod) -> dict[str, Any]:
    """The schema of its parameters, without the one that the key determines."""
    schema = method.parameters.model_json_schema()
    schema.get("properties", {}).pop(WHO, None)
    return schema


def _given(payload: bytes) -> dict[str, Any]:
    """The parameters in a request; an empty request has none."""
    try:
        return json_object(payload or b"{}")
    except ValueError:
        raise RefusedCallError("a request is one JSON object that gives each parameter at most once") from None
