"""The figures of a frequency response: gain, phase and coherence from a chirp (Fig. 5), damping over amplitude."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats
from ..identification.coordinates import axis_of
from ..identification.dataset import DataError, Record
from ..identification.frequency_response import LEAST_COHERENCE, FrequencyResponse, frequency_response
from ..model.axis import AxisState, simulate
from ..model.friction import REST, steady_friction_nm
from .document import significant
from .figures import FREQUENCY, Dash, Figure, PlotAxis, Series
from .identify_figures import COLOURS, IdentifyWords, figure_name

BALANCE_ANGLES = 64
LEAST_SHOWN = 0.2  # coherence below which a point is not drawn
DASHES: tuple[Dash, ...] = ("dotted", "dashdot", "dashed")


class ChirpResponse(NamedTuple):
    """The response to one chirp, and that of the fitted model to the same chirp."""

    record: Record
    measured: FrequencyResponse
    modelled: FrequencyResponse | None
    gain_rps_per_a: float  # of the first-order plant fitted to the gain
    time_constant_s: float
    amplitude_rps: float  # rms velocity times the root of two


def responses(records: Sequence[Record], found: dict[str, Any], physical: Floats) -> list[ChirpResponse]:
    """Of the records that have a fit in results["frequency_response"]; the model goes through the same estimate."""
    result = []
    for record in records:
        entry = found.get(record.name)
        if entry is None or "first_order" not in entry:
            continue
        columns = (entry[name] for name in FrequencyResponse._fields)
        measured = FrequencyResponse(*(np.array(column) for column in columns))
        fit = entry["first_order"]
        result.append(
            ChirpResponse(
                record, measured, _modelled(record, physical), fit["gain_rps_per_a"], fit["time_constant_s"],
                _amplitude(record),
            )
        )  # fmt: skip
    return result


def _amplitude(record: Record) -> float:
    block = max(1, round(0.005 / record.period_s))
    velocity = np.diff(record.position_rev[::block]) / (block * record.period_s)
    return math.sqrt(2.0 * float(np.mean(velocity * velocity)))


def _modelled(record: Record, physical: Floats) -> FrequencyResponse | None:
    axis, _ = axis_of(physical, record.torque_constant_nm_per_a)
    start = AxisState(0.0, 0.0, REST)
    states, _ = simulate(axis, start, np.ascontiguousarray(record.current_a), record.period_s, 2)
    try:
        return frequency_response(replace(record, position_rev=states[:, 1]))
    except DataError:
        return None


def response_figures(
    response: ChirpResponse, damping: list[dict[str, float]], inertia: float, words: IdentifyWords
) -> list[Figure]:
    """Gain with first-order plants by amplitude, phase, coherence: of one chirp."""
    record, measured = response.record, response.measured
    frequency = measured.frequency_hz
    used = measured.coherence > LEAST_COHERENCE
    seen = measured.coherence > LEAST_SHOWN
    gain = [
        Series("measured", frequency[used], measured.gain_rps_per_a[used], "orange", "points"),
        Series("first order, fitted", frequency, _first_order(response, frequency), "blue", weight=2.0),
    ]
    phase = [Series("measured", frequency[used], _unwrapped(measured.phase_deg)[used], "orange", "points")]
    if response.modelled is not None:
        at = response.modelled.frequency_hz
        shown = np.interp(at, frequency, seen.astype(np.float64)) > 0.5
        own = np.where(shown, response.modelled.gain_rps_per_a, np.nan)
        gain.append(Series("model, same chirp", at, own, "green", dash="dashed"))
        turned = np.where(shown, _unwrapped(response.modelled.phase_deg), np.nan)
        phase.append(Series("model, same chirp", at, turned, "green", dash="dashed"))
    if (seen & ~used).any():
        doubtful = seen & ~used
        gain.append(
            Series("coherence below 0.6", frequency[doubtful], measured.gain_rps_per_a[doubtful], "purple", "points")
        )
    for place, dash in zip((0.15, 0.5, 1.0), DASHES, strict=True):
        if damping:
            point = damping[round(place * (len(damping) - 1))]
            line = record.torque_constant_nm_per_a / np.hypot(
                point["damping_nm_per_rps"], 2.0 * np.pi * frequency * inertia
            )
            name = f"at {significant(point['amplitude_rps'], 2)} {words.velocity_unit}"
            gain.append(Series(name, frequency, line, "grey", dash=dash))
    unit = f"{words.velocity_unit}/{words.command_unit}"
    group = figure_name("response", record.name)
    caption = (
        f"As in the paper's Fig. 5, from {record.name}. First-order fit to the gain: "
        f"{significant(response.gain_rps_per_a)} {unit}, "
        f"{significant(1e3 * response.time_constant_s)} ms. Grey: Kt/(J p + D) with the damping D of three amplitudes."
    )
    coherence = Series("coherence", frequency, measured.coherence, "orange", "points")
    return [
        Figure(figure_name("gain", record.name), "xy", f"{record.name}: gain", caption, FREQUENCY,
               PlotAxis("gain", unit, log=True), tuple(gain), height_px=300, group=group),
        Figure(figure_name("phase", record.name), "xy", f"{record.name}: phase",
               "Not used in the fit: frictional lag and delay distort it.", FREQUENCY, PlotAxis("phase", "deg"),
               tuple(phase), width="half", height_px=190, group=group),
        Figure(figure_name("coherence", record.name), "xy", f"{record.name}: coherence",
               "Points below 0.6 are not used; friction that changes with amplitude also lowers the coherence.",
               FREQUENCY, PlotAxis("coherence", "-", limits=(0.0, 1.05)), (coherence,), width="half",
               height_px=190, group=group),
    ]  # fmt: skip


def _first_order(response: ChirpResponse, frequency_hz: Floats) -> Floats:
    return np.asarray(response.gain_rps_per_a / np.hypot(1.0, 2.0 * np.pi * frequency_hz * response.time_constant_s))


def _unwrapped(phase_deg: Floats) -> Floats:
    return np.degrees(np.unwrap(np.radians(phase_deg)))


def damping_figure(damping: list[dict[str, float]], physical: Floats, words: IdentifyWords) -> Figure:
    """Damping over amplitude (17): from the records, and from the model's steady curve by harmonic balance."""
    amplitude = np.array([point["amplitude_rps"] for point in damping])
    measured = np.array([point["damping_nm_per_rps"] for point in damping])
    grid = np.geomspace(0.7 * amplitude.min(), 1.3 * amplitude.max(), 81)
    friction = axis_of(physical, 1.0)[0].friction
    steady = np.array([harmonic_damping(friction, float(a)) for a in grid])
    return Figure(
        name="damping", kind="xy", title="Damping over amplitude",
        caption="Power dissipated by friction divided by the mean square of the velocity, in windows of 0.5 s; "
                "line: steady friction of the model by harmonic balance; dotted: viscous part "
                "alone. Only the points contain presliding and lag.",
        x=PlotAxis("amplitude of the velocity", words.velocity_unit, log=True),
        y=PlotAxis("damping", words.damping_unit, log=True), width="half",
        series=(
            Series("measured", amplitude, measured, "orange", "points"),
            Series("model, steady", grid, steady, "blue", weight=2.0),
            Series("viscous", grid, np.full(grid.size, friction.viscous_nm_per_rps), COLOURS[4], dash="dotted"),
        ),
    )  # fmt: skip


def harmonic_damping(friction: Any, amplitude_rps: float) -> float:
    """Harmonic balance: 2 / (pi A) times the integral over half a turn of S(A sin) sin."""
    angles = (np.arange(BALANCE_ANGLES) + 0.5) * np.pi / BALANCE_ANGLES
    sines = np.sin(angles)
    torque = np.array([steady_friction_nm(friction, amplitude_rps * float(s)) for s in sines])
    return float(2.0 * np.mean(torque * sines) / amplitude_rps)
