"""Where a server of the daemon listens: `PORT` on this machine alone, or `HOST:PORT`."""

from __future__ import annotations

import ipaddress
import os
from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple

from pydantic import BeforeValidator, Field, WithJsonSchema

LOCAL = ("127.0.0.1", "localhost")
WILDCARDS = ("", "0.0.0.0", "::", "*")
HIGHEST_PORT = 65535


class Address(NamedTuple):
    """Where to listen. Port 0: a free one."""

    host: str
    port: int

    @property
    def names(self) -> tuple[str, ...]:
        """What a browser may call us."""
        hosts = LOCAL if self.host in LOCAL else (self.host,)
        return tuple(f"[{host}]:{self.port}" if ":" in host else f"{host}:{self.port}" for host in hosts)


def address_of(text: str) -> Address:
    """`PORT`, or `HOST:PORT`. Raises ValueError."""
    host, colon, port = text.rpartition(":")
    host = host.strip("[]") if colon else LOCAL[0]
    if not port.isascii() or not port.isdecimal() or int(port) > HIGHEST_PORT:
        raise ValueError(f"'{text}': give PORT or HOST:PORT")
    if host in WILDCARDS:
        raise ValueError(f"'{text}': give the one address or name that browsers use")
    return Address(host, int(port))


def in_unit(environment: Mapping[str, str] = os.environ) -> bool:
    """This process was started by the service's unit, which makes its directory for it."""
    return bool(environment.get("RUNTIME_DIRECTORY"))


def sandbox_problem(address: Address) -> str | None:
    """What the sandbox of the service's unit keeps from this address, and what to change; None: nothing."""
    if address.host in LOCAL:
        return None
    try:
        found = ipaddress.ip_address(address.host)
    except ValueError:
        found = None  # a name
    lines: list[str] = []
    if found is None or not found.is_loopback:
        lines.append("IPAddressAllow= with the network that may connect")
    if found is not None and found.version == 6:
        lines.append("RestrictAddressFamilies=AF_INET6")
    if not lines:
        return None
    return (
        f"{address.names[0]} is closed by the sandbox of fffo-drive@.service; for a service add with `systemctl edit`, "
        f"under [Service], if it is not there: {'; '.join(lines)}"
    )


def _listen(value: Any) -> Any:
    """A port as YAML has it, or text, as text that can be used."""
    if isinstance(value, bool) or not isinstance(value, int | str):
        raise ValueError("give PORT or HOST:PORT")
    address_of(str(value))
    return str(value)


_SCHEMA = {
    "anyOf": [
        {"type": "integer", "minimum": 0, "maximum": HIGHEST_PORT},
        {"type": "string", "pattern": r"^(.+:)?[0-9]{1,5}$"},
    ]
}
# a key of a configuration file
Listen = Annotated[str, BeforeValidator(_listen), WithJsonSchema(_SCHEMA), Field(examples=[8700, "192.0.2.7:8700"])]
