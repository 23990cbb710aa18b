"""Decimation for figures: of each bucket of samples the smallest and the largest, in their order."""

from __future__ import annotations

import numpy as np

from ..arrays import Floats
from .figures import Series, Uniform

BRIDGED = 20  # missing samples in a row that do not break a line


def decimate(y: Floats, most: int) -> tuple[Floats, int]:
    """At most `most` points (at least 4) of equidistant samples (n,), and how many samples a bucket has (1: untouched).

    Points 2 j and 2 j + 1 are the extremes of bucket j in their order, so every extreme of the record is kept. NaN are
    ignored; a bucket of NaN alone gives NaN.
    """
    most = max(4, most)
    if y.size <= most:
        return y, 1
    bucket = -(-y.size // (most // 2))
    padded = np.full(-(-y.size // bucket) * bucket, np.nan)
    padded[: y.size] = y
    table = padded.reshape(-1, bucket)
    missing = np.isnan(table)
    lowest = np.argmin(np.where(missing, np.inf, table), axis=1)
    highest = np.argmax(np.where(missing, -np.inf, table), axis=1)
    ends = np.stack([np.minimum(lowest, highest), np.maximum(lowest, highest)], axis=1)
    points = np.take_along_axis(table, ends, axis=1)
    points[missing.all(axis=1)] = np.nan
    return points.reshape(-1), bucket


def decimated_abscissa(x: Uniform, bucket: int) -> Uniform:
    """Where the points of `decimate` stand: the middles of the halves of their buckets."""
    if bucket == 1:
        return x
    return Uniform(x.start + (0.25 * bucket - 0.5) * x.step, 0.5 * bucket * x.step)


def thinned(series: Series, most: int) -> tuple[Floats | Uniform, Floats, int]:
    """Abscissae and ordinates of a series in at most `most` points or so, and the bucket.

    Equidistant ones by extremes, curves in the plane by every k-th point; histograms and bars stay whole.
    """
    if isinstance(series.x, Uniform):
        y, bucket = decimate(series.y, most)
        return decimated_abscissa(series.x, bucket), y, bucket
    if series.draw not in ("line", "points") or series.y.size <= most:
        return series.x, series.y, 1
    stride = -(-series.y.size // most)
    return series.x[::stride], series.y[::stride], stride


def most_bridged(bucket: int) -> int:
    """Consecutive points that may be missing without breaking the line: a few samples; none if decimated."""
    return BRIDGED if bucket == 1 else 0


def bridged(x: Floats, y: Floats, bucket: int) -> tuple[Floats, Floats]:
    """A line (n,) without the missing points that do not break it."""
    missing = np.isnan(y)
    ends = np.flatnonzero(np.diff(missing, prepend=False, append=False))
    for start, end in ends.reshape(-1, 2):
        if end - start > most_bridged(bucket):
            missing[start:end] = False
    return x[~missing], y[~missing]
