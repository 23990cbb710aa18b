"""COB-IDs of PDOs, SYNC and EMCY: their flags, and the identifiers that they may not have (CiA 301, 7.3.5)."""

from __future__ import annotations

from ..can.frame import STANDARD_MASK
from .abort import Abort, SdoAbortError

INVALID = 0x80000000  # bit 31 of the COB-ID of a PDO or EMCY
NO_RTR = 0x40000000  # bit 30 of the COB-ID of a PDO


def check_can_id(cob_id: int) -> None:
    """Refuse what a configurable COB-ID may not be: 29 bit, or restricted. Raises SdoAbortError."""
    if cob_id > STANDARD_MASK or is_restricted(cob_id):
        raise SdoAbortError(Abort.INVALID_VALUE)


def is_restricted(identifier: int) -> bool:
    """CAN-IDs that no configurable object may use: NMT, SDO, error control and reserved ranges."""
    return (
        identifier <= 0x07F
        or 0x101 <= identifier <= 0x180
        or 0x581 <= identifier <= 0x5FF
        or 0x601 <= identifier <= 0x67F
        or identifier >= 0x6E0
    )
