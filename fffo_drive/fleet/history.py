"""A drive's records in the order of time, as plain arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


class RunHistory(NamedTuple):
    """n runs of one drive, oldest first; p base parameters, k orders. Linear: revolutions stand for m, Nm for N."""

    time_s: Floats  # (n,) start, UTC, seconds since 1970
    theta: Floats  # (n, p) base parameters, finite; what a run does not determine is the smallest that fits
    information: Floats  # (n, p, p) inverse covariance of theta; 0 along what a run does not determine
    names: tuple[str, ...]  # (p,) `fleet.regress.PARAMETERS`, with their units
    rms_nm: Floats  # (n,) of the residual of the run's own regression
    order_amplitude_nm: Floats  # (n, k) of the residual; nan where the run does not resolve an order
    orders: Floats  # (k,) periods a motor turn
    speed_rms_rps: Floats  # (n,)
    temperature_degc: Floats  # (n,) mean; nan where not logged
    run: npt.NDArray[np.str_]  # (n,) content hash of each run, hex
