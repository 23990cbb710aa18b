"""The SDO client of `canopen`. It is imported where one is made: the library takes longer than checking a file."""

from __future__ import annotations

import queue
import time
from typing import Any

from canopen import ObjectDictionary, SdoAbortedError, SdoCommunicationError
from canopen.sdo.client import SdoClient

from .object_lengths import SDO_ABORT, LengthOf, standard_length
from .object_map import object_name

INITIATE_DOWNLOAD, INITIATE_UPLOAD = 1, 2  # upper three bits of a request; 0 and 3: segments
ANSWER_TO = {0: 1, INITIATE_DOWNLOAD: 3, INITIATE_UPLOAD: 2, 3: 0}  # and of the answer to it
KINDS = {0: "a segment written", 1: "a write", 2: "a read", 3: "a segment read"}
TOGGLE_BIT = 0x10
NO_OBJECTS: Any = ObjectDictionary()  # type: ignore[no-untyped-call]


class WrongAnswerError(SdoCommunicationError):
    """Answers came, and none of them to the request."""


def wrong_answer(request: bytes, asked: bytes, answer: bytes) -> str:
    """Why an answer does not belong to a request; empty if it does (CiA 301 7.2.4.3).

    `asked`: index and sub-index of the transfer, which its segments do not repeat. An abort may leave them out.
    """
    command, expected = answer[0] >> 5, ANSWER_TO[request[0] >> 5]
    initiates = request[0] >> 5 in (INITIATE_DOWNLOAD, INITIATE_UPLOAD)
    aborted = answer[0] == SDO_ABORT
    cause = "a late answer to an earlier request, or a second master that asks this node"
    if not aborted and command != expected:
        wanted = f"the answer to {KINDS[request[0] >> 5]} (0x{expected << 5:02X} in its upper three bits)"
        return f"expected {wanted}, got the command 0x{answer[0]:02X} ({cause})"
    names_object = any(answer[1:4]) if aborted else initiates
    if names_object and answer[1:4] != asked:
        wanted, found = (object_name(int.from_bytes(one[:2], "little"), one[2]) for one in (asked, answer[1:4]))
        kind = "an abort of" if aborted else "one to"
        return f"expected the answer to {wanted}, got {kind} {found} ({cause})"
    if not aborted and not initiates and (answer[0] ^ request[0]) & TOGGLE_BIT:
        return f"the toggle bit of a segment does not alternate (command 0x{answer[0]:02X} after 0x{request[0]:02X})"
    return ""


class QuietSdoClient(SdoClient):
    """The library's client, without its own log message on a timeout, which is raised as an error here.

    An answer that does not belong to the request is passed over: a late one may come before the right one.
    """

    length_of: LengthOf = staticmethod(standard_length)
    request = bytes(8)  # that waits for its answer
    asked = bytes(3)  # index and sub-index of the transfer

    def send_request(self, request: bytes) -> None:
        """Send it, and keep it for its answer."""
        if request[0] != SDO_ABORT:
            self.request = bytes(request)
            if request[0] >> 5 in (INITIATE_DOWNLOAD, INITIATE_UPLOAD):
                self.asked = bytes(request[1:4])
        super().send_request(request)  # type: ignore[no-untyped-call]

    def read_response(self) -> bytes:
        """The answer to the request. Raises SdoAbortedError, SdoCommunicationError (WrongAnswerError)."""
        end_s = time.monotonic() + self.RESPONSE_TIMEOUT
        wrong = ""
        while True:
            try:
                answer: bytes = self.responses.get(timeout=max(0.0, end_s - time.monotonic()))
            except queue.Empty:
                raise WrongAnswerError(wrong) if wrong else SdoCommunicationError("no answer") from None
            wrong = wrong_answer(self.request, self.asked, answer)
            if wrong:
                continue
            if answer[0] == SDO_ABORT:
                raise SdoAbortedError(int.from_bytes(answer[4:8], "little"))
            return answer

    def upload(self, index: int, subindex: int) -> bytes:
        with self.open(index, subindex, buffering=0) as stream:  # type: ignore[no-untyped-call]
            sized, data = stream.size is not None, bytes(stream.read())
        return data if sized else data[: self.length_of(index, subindex)]

    def abort(self, abort_code: int = 0x08000000) -> None:
        self.send_request(bytes([SDO_ABORT, 0, 0, 0]) + abort_code.to_bytes(4, "little"))
