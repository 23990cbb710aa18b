"""How long the disk lasts for a recording: until it is full, and how much of it a quota keeps."""

from __future__ import annotations

import math
from typing import NamedTuple

from ..signals import ROW
from ..units import S_PER_DAY, S_PER_HOUR, S_PER_MIN
from .settings import Compression

DECIMALS = ((1e12, "TB"), (1e9, "GB"), (1e6, "MB"), (1e3, "kB"))
SPANS = ((S_PER_DAY, "days"), (S_PER_HOUR, "h"), (S_PER_MIN, "min"), (1.0, "s"))
LEAST_OF_SPAN = 2.0  # below so many days a time is said in hours, and so on


# bytes in a file for one byte of a row, measured on an axis in motion over a bus (at rest it is less)
COMPRESSED_SHARE = {"zstd": 0.4, "none": 1.1}


def row_bytes(compression: Compression) -> float:
    """What a row takes in a file, about."""
    return COMPRESSED_SHARE[compression] * ROW.itemsize


class DiskUse(NamedTuple):
    """What a recorder found in its directory."""

    free_bytes: int  # available to this user
    own_bytes: int  # of the recordings that the quota counts


class DiskLife(NamedTuple):
    """What that means at a rate of recording."""

    bytes_per_s: float
    free_bytes: int
    quota_bytes: int | None
    full_in_s: float  # until the disk is full, if nothing were deleted
    kept_s: float | None  # how far back the quota reaches; None: there is none, or the disk is full before

    @property
    def fills(self) -> bool:
        """Whether the disk will be full: nothing is deleted before."""
        return self.kept_s is None


def disk_life(bytes_per_s: float, use: DiskUse, quota_bytes: int | None) -> DiskLife:
    """`bytes_per_s` > 0: measured, or estimated."""
    fits = quota_bytes is not None and quota_bytes - use.own_bytes <= use.free_bytes
    kept_s = quota_bytes / bytes_per_s if fits and quota_bytes is not None else None
    return DiskLife(bytes_per_s, use.free_bytes, quota_bytes, use.free_bytes / bytes_per_s, kept_s)


def life_text(life: DiskLife) -> str:
    """In one sentence, for people."""
    rate = f"{bytes_text(life.bytes_per_s * S_PER_DAY)} a day"
    free = f"{bytes_text(life.free_bytes)} free"
    lasts = f"{rate}: the disk lasts {span_text(life.full_in_s)} ({free})"
    if life.quota_bytes is None:
        return f"{lasts}, without a quota: then rows are lost"
    quota = f"the quota of {bytes_text(life.quota_bytes)}"
    if life.kept_s is None:
        return f"{lasts} and is full before {quota} is reached: then rows are lost; lower recording.quota_bytes"
    return f"{lasts}; with {quota} the last {span_text(life.kept_s)} are kept"


def bytes_text(size: float) -> str:
    """1.2 GB: decimal, as disks are sold."""
    for factor, unit in DECIMALS:
        if size >= factor:
            return f"{size / factor:.3g} {unit}"
    return f"{size:.0f} bytes"


def span_text(time_s: float) -> str:
    """3.2 days, 21 h."""
    if not math.isfinite(time_s):
        return "for ever"
    unit_s, unit = next((one for one in SPANS if time_s >= LEAST_OF_SPAN * one[0]), SPANS[-1])
    return f"{time_s / unit_s:.2g} {unit}" if time_s / unit_s < 100 else f"{time_s / unit_s:.0f} {unit}"
