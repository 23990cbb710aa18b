"""Results of a fit: the model file and the report, as plain numbers."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import scipy  # its modules load where they are first used

from .. import __version__, formats
from ..model.effects.registry import law_of
from ..model.parameters import FrictionModel, ModelFile, Provenance, Quantity
from ..symbols import SYMBOLS
from ..units import inertia_kg_m2, name_on, text_on, unit_on
from .coordinates import LOGARITHMIC, MODEL_PARAMETERS, PARAMETERS
from .dataset import DataError, Record
from .declared import weight_remarks
from .facts import DriveFacts
from .fit import OTHER_RATIOS, Fit
from .frequency_response import damping_over_amplitude, fit_first_order, frequency_response
from .residuals import residual_summary
from .runs import RunLook, look_at_runs
from .uncertainty import Doubt

CONFIDENCE = 0.95
LARGEST_LOG_REACH = math.log(1e6)  # a wider interval is not meaningful
INERTIA, MASS = "inertia_nm_s2_per_rev", "M"


def unit_of(name: str, facts: DriveFacts) -> str:
    """Unit of a parameter on this kind of axis."""
    return unit_on(SYMBOLS[name].unit, facts.units == "linear")


def symbol_of(name: str, facts: DriveFacts) -> str:
    """Name of a parameter: a linear axis has a mass instead of an inertia."""
    return MASS if facts.units == "linear" and name == INERTIA else SYMBOLS[name].symbol


def model_file(
    fit: Fit, records: Sequence[Record], name: str, units: Literal["rotary", "linear"] = "rotary"
) -> ModelFile:
    """The fitted model as the controller runs it. The delay of the drive's velocity, where there is one, is added."""

    def quantity(key: str, factor: float = 1.0) -> Quantity:
        k = PARAMETERS.index(key)
        sd = float(fit.uncertainty.sd[k])
        value = float(fit.physical[k]) * factor
        return Quantity(value=value, sd=sd * factor if sd > 0.0 else None, source=_source(fit, k))

    sensor_s, sensor_sd_s = max(0.0, fit.sensor_delay_s or 0.0), fit.sensor_delay_sd_s
    delay = quantity("delay_s")
    whole_sd_s = None if delay.sd is None else math.hypot(delay.sd, sensor_sd_s or 0.0)
    to_kg_m2 = inertia_kg_m2(1.0)
    friction = FrictionModel(
        stribeck="classical",
        omega="clipped",
        **{key: quantity(key) for key in MODEL_PARAMETERS if key not in ("inertia_nm_s2_per_rev", "delay_s")},
    )
    return ModelFile(
        name=name,
        units=units,
        torque_constant_nm_per_a=records[0].torque_constant_nm_per_a,
        inertia_kg_m2=quantity("inertia_nm_s2_per_rev", to_kg_m2),
        delay_s=Quantity(
            value=delay.value + sensor_s, sd=whole_sd_s, source="fitted on the position, and the sensor's"
        ),
        sensor_delay_s=Quantity(
            value=sensor_s, sd=sensor_sd_s, source="lag of the drive's velocity behind its position"
        ),
        friction=friction,
        effects=[effect.model(provenance=f"fffo-drive {__version__} identify") for effect in fit.effects],
        provenance=Provenance(
            date=time.strftime("%Y-%m-%d"), tool=f"fffo-drive {__version__} identify", runs=[r.digest for r in records]
        ),
    )


def _source(fit: Fit, k: int) -> str:
    """What a parameter's value is."""
    if fit.uncertainty.sd[k] > 0.0:
        return "fitted"
    low, value, high = fit.space.low[k], fit.solution.values[k], fit.space.high[k]
    return "at a bound" if low < high and not low < value < high else "not determined"


def report(fit: Fit, records: Sequence[Record], facts: DriveFacts) -> dict[str, Any]:
    """Contents of the page, JSON-ready: runs, parameters, effects, undetermined parameters, residuals, frequency
    response, damping.
    """
    looked = look_at_runs(records)
    linear = facts.units == "linear"
    remarks = [remark._replace(text=text_on(remark.text, linear)) for remark in looked.remarks]
    return {
        "format": formats.IDENTIFICATION.word,
        "tool": f"fffo-drive {__version__}",
        "date": time.strftime("%Y-%m-%d"),
        "units": facts.units,
        "torque_constant_nm_per_a": facts.torque_constant_nm_per_a,
        "runs": [_run(record) for record in records],
        "runs_by_themselves": [look._asdict() | {"estimates": _estimates(look)} for look in looked.runs],
        "remarks": [remark._asdict() for remark in remarks],
        "parameters": _parameters(fit, facts),
        "effects": _effects(fit, records, facts),
        "sensor_delay_s": fit.sensor_delay_s,
        "sensor_delay_sd_s": fit.sensor_delay_sd_s,
        "doubts": [_doubt(doubt, facts) for doubt in fit.uncertainty.doubts],
        "warnings": [
            *(text_on(text, linear) for text in fit.warnings),
            *(remark.text for remark in remarks),
            *_weight_remarks(fit, records, facts),
            *(text for record in records for text in record.warnings),
        ],
        "start": fit.start._asdict(),
        "fit": _fit(fit),
        "residuals": residual_summary(fit.runs),
        "frequency_response": _responses(records),
        "damping": [
            point._asdict()
            for point in damping_over_amplitude(records, fit.value("inertia_nm_s2_per_rev"), fit.value("delay_s"))
        ],
    }


def _doubt(doubt: Doubt, facts: DriveFacts) -> dict[str, Any]:
    linear = facts.units == "linear"
    shown = {"reason": text_on(doubt.reason, linear), "excitation": text_on(doubt.excitation, linear)}
    return doubt._asdict() | shown | {"symbol": symbol_of(doubt.name, facts)}


def _weight_remarks(fit: Fit, records: Sequence[Record], facts: DriveFacts) -> list[str]:
    """Comparison of the fitted weight of the load with the declared one."""
    found = [
        (effect["name"], [(row["name"], row["value"], row["sd"]) for row in effect["parameters"]])
        for effect in _effects(fit, records, facts)
    ]
    ends = np.concatenate([[record.position_rev.min(), record.position_rev.max()] for record in records])
    return weight_remarks(facts, found, float(np.ptp(ends)))


def _run(record: Record) -> dict[str, Any]:
    return {
        "name": record.name,
        "path": record.path.name,
        "sha256": record.digest,
        "duration_s": record.duration_s,
        "rate_hz": 1.0 / record.period_s,
        "closed_loop": record.closed_loop,
        "gaps": len(record.breaks),
        "travel_rev": float(np.ptp(record.position_rev)),
        "position_lsb_rev": record.lsb_rev,
    }


def _estimates(look: RunLook) -> dict[str, Any]:
    return {name: estimate._asdict() for name, estimate in look.estimates.items()}


def _effects(fit: Fit, records: Sequence[Record], facts: DriveFacts) -> list[dict[str, Any]]:
    """The effects of the model, each number with its interval, and their evidence on the rows of the ladder."""
    linear = facts.units == "linear"
    accepted = () if fit.ladder is None else fit.ladder.accepted
    found = []
    for k, effect in enumerate(fit.effects):
        law = law_of(effect.name)
        numbers = []
        for p in law.parameters:
            values = effect.per_run.get(p.name, (effect.values.get(p.name),))
            sds = effect.per_run_sd.get(p.name, (effect.sd.get(p.name),))
            runs = [record.name for record in records] if p.name in effect.per_run else [None]
            for run, value, sd in zip(runs, values, sds, strict=True):
                if value is None:
                    continue
                reach = reach_of(fit) * sd if sd else None
                numbers.append({
                    "name": p.name, "symbol": name_on(p.name, p.unit, linear), "run": run,
                    "unit": unit_on(p.unit, linear), "value": value, "sd": sd or None,
                    "interval_95": None if reach is None else [value - reach, value + reach],
                })  # fmt: skip
        row: dict[str, Any] = {"name": effect.name, "meaning": text_on(law.meaning, linear), "parameters": numbers}
        if accepted:
            one = accepted[k]
            row |= {
                "gain": one.gain.value, "gain_sd": one.gain.sd, "p": one.p, "share_of_the_others_residual": one.share,
            }  # fmt: skip
        found.append(row)
    return found


def reach_of(fit: Fit) -> float:
    """Half an interval over its standard deviation."""
    windows = fit.uncertainty.windows - len(MODEL_PARAMETERS)
    return float(scipy.stats.t.ppf(0.5 + 0.5 * CONFIDENCE, max(2, windows)))


def _parameters(fit: Fit, facts: DriveFacts) -> list[dict[str, Any]]:
    u = fit.uncertainty
    reach = reach_of(fit)
    rows = []
    for k, name in enumerate(PARAMETERS):
        fitted = fit.space.high[k] > fit.space.low[k]
        value, sd = float(fit.physical[k]), float(u.sd[k])
        known = sd > 0.0  # not where a bound stopped the fit
        rows.append({
            "name": name, "symbol": symbol_of(name, facts), "unit": unit_of(name, facts), "value": value,
            "fitted": bool(fitted), "source": _source(fit, k), "of_the_model": name in MODEL_PARAMETERS,
            "sd": sd if known else None,
            "interval_95": ends_of_interval(name, value, reach * sd) if known else None,
            "statistical_sd": float(u.statistical_sd[k]), "specification_sd": float(u.specification_sd[k]),
            "windows_that_tell": float(u.moments[k]), "variance_inflation": float(u.inflation[k]),
        })  # fmt: skip
    return rows


def ends_of_interval(name: str, value: float, reach: float) -> list[float]:
    """Both ends; of a positive parameter, which is fitted as a logarithm, symmetric in that."""
    if name in LOGARITHMIC:
        factor = math.exp(min(reach / value, LARGEST_LOG_REACH))
        return [value / factor, value * factor]
    return [value - reach, value + reach]


def _fit(fit: Fit) -> dict[str, Any]:
    return {
        "residual": "prediction error of the position, averaged over blocks",
        "residual_rms_lsb": math.sqrt(fit.solution.cost),
        "robust_sd_lsb": fit.solution.scale,
        "residuals": fit.problem.rows,
        "block_samples": fit.problem.shooting.block,
        "observer_velocity_gain_per_s": fit.problem.shooting.velocity_gain_per_s,
        "other_bandwidth_ratios": list(OTHER_RATIOS),
        "windows": fit.uncertainty.windows,
        "iterations": fit.solution.iterations,
        "converged": fit.solution.converged,
        "literal_stribeck_loss_ratio": fit.literal_loss,
        "names": list(fit.space.names),
        "correlation": np.round(fit.uncertainty.correlation, 4).tolist(),
    }


def _responses(records: Sequence[Record]) -> dict[str, Any]:
    """Frequency responses of the open-loop runs; in closed loop noise would go round the loop into the estimate."""
    found: dict[str, Any] = {}
    for record in records:
        if record.closed_loop:
            continue
        try:
            response = frequency_response(record)
            first_order = fit_first_order(response)._asdict()
        except DataError as error:
            found[record.name] = {"error": str(error)}
            continue
        found[record.name] = {name: values.tolist() for name, values in response._asdict().items()}
        found[record.name]["first_order"] = first_order
    return found
