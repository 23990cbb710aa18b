"""The linear axis with the response that commissioning measured in place of what the model says of it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..control.stability import (
    RIGID,
    ElasticLoad,
    LinearAxis,
    MeasuredResponse,
    mechanics_nm_per_rps,
    spread_of,
)
from ..model.parameters import ModelFile

if TYPE_CHECKING:
    from ..commissioning.record import ResponseRecord

LEAST_COHERENCE = 0.8  # below, a point is noise


def response_in(file: Path) -> ResponseRecord | None:
    """The response in a record; None where there is no record, or it has none. Raises DocumentError."""
    if not file.exists():
        return None
    from ..commissioning.record import read_record

    return read_record(file).response


def with_response(axis: LinearAxis, model: ModelFile, response: ResponseRecord) -> LinearAxis:
    """The axis as the sweeps found it: its elastic load or none, the longer delay, what it is beside them, and the
    contact that holds it at rest.

    An elastic load of the model counts where the sweep did not look for one.
    """
    found, band_hz = response.elastic, response.frequency_hz
    elastic, spread = axis.elastic, axis.resonance_spread
    if found is not None:
        elastic = ElasticLoad(found.share, found.frequency_hz, found.damping)
        spread = spread_of(found.frequency_hz, found.frequency_sd_hz)
    elif band_hz[0] <= elastic.frequency_hz <= band_hz[-1]:
        elastic, spread = RIGID, 0.0
    frequency_hz, gain, phase_deg = (np.array(v) for v in (band_hz, response.gain_rps_per_a, response.phase_deg))
    s = 2j * math.pi * frequency_hz
    late = np.exp(-s * (response.delay_s + response.hold_s))
    whole = response.gain_rps2_per_a * late / (gain * np.exp(1j * np.radians(phase_deg)))
    mechanics = whole - response.damping_per_s - response.contact_per_s2 / s
    inertia = axis.torque_constant_nm_per_a / response.gain_rps2_per_a
    ratio = inertia * mechanics / mechanics_nm_per_rps(axis.inertia_nm_s2_per_rev, elastic, s)
    sure = np.array(response.coherence) >= LEAST_COHERENCE
    measured = MeasuredResponse(tuple(frequency_hz[sure].tolist()), tuple(ratio[sure].tolist()))
    return axis._replace(
        elastic=elastic,
        resonance_spread=spread,
        delay_s=axis.delay_s + longer_s(model, response),
        measured=measured if measured.frequencies_hz else None,
        measured_contact_nm_per_rev=response.contact_nm_per_rev(axis.torque_constant_nm_per_a),
    )


def longer_s(model: ModelFile, response: ResponseRecord) -> float:
    """By how much the measured delay is longer than the model's."""
    return max(0.0, response.delay_s - model.delay_s.value)
