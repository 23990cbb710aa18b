"""The SDO client of `canopen`. It is imported where one is made: the library takes longer than checking a file."""

from __future__ import annotations

from typing import Any

from canopen import ObjectDictionary
from canopen.sdo.client import SdoClient

from .object_lengths import SDO_ABORT, LengthOf, standard_length

NO_OBJECTS: Any = ObjectDictionary()  # type: ignore[no-untyped-call]


class QuietSdoClient(SdoClient):
    """The library's client, without its own log message on a timeout, which is raised as an error here."""

    length_of: LengthOf = staticmethod(standard_length)

    def upload(self, index: int, subindex: int) -> bytes:
        with self.open(index, subindex, buffering=0) as stream:  # type: ignore[no-untyped-call]
            sized, data = stream.size is not None, bytes(stream.read())
        return data if sized else data[: self.length_of(index, subindex)]

    def abort(self, abort_code: int = 0x08000000) -> None:
        self.send_request(bytes([SDO_ABORT, 0, 0, 0]) + abort_code.to_bytes(4, "little"))  # type: ignore[no-untyped-call]
