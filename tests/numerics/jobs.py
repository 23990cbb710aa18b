"""What two processors are asked: fits, searches and designs on the same records, and runs that each simulates itself.

From records that were written once the same answer has to come out, to rounding. A run that is simulated anew is not
the same to rounding: its reference ends in another digit, the resolver rounds one sample the other way, and from there
on the closed loop has other noise. Of such runs what the data determine is compared, as far as noise leaves it.
"""

from __future__ import annotations

import json
import pickle
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from identification.rig import random_plant, record
from identification.synthetic import AXIS, PERIOD_S
from identification.test_fit import excited

from fffo_drive.config.scenario import case_of, read_scenario
from fffo_drive.control.stability import LinearAxis
from fffo_drive.diagnosis.diagnose import DiagnosisSettings, diagnose
from fffo_drive.diagnosis.results import report
from fffo_drive.drive.simulated.parameters import EffectConfig
from fffo_drive.evaluation.campaign import run_case
from fffo_drive.evaluation.summary import figures_of
from fffo_drive.identification.coordinates import PARAMETERS
from fffo_drive.identification.dataset import Record
from fffo_drive.identification.excitation import identification_sequence, separating_recipe
from fffo_drive.identification.facts import DriveFacts
from fffo_drive.identification.fit import fit_records
from fffo_drive.identification.tuning import design
from fffo_drive.model.axis import AxisState, simulate
from fffo_drive.model.effects.registry import LAWS
from fffo_drive.model.friction import REST

Answer = dict[str, Any]
Records = dict[str, Any]
Runs = tuple[list[Record], list[Record]]

SCENARIO = Path(__file__).resolve().parents[2] / "configs" / "scenarios" / "paper.yaml"
FACTS = DriveFacts(torque_constant_nm_per_a=0.148, rated_current_a=8.3, gear_ratio=160.0, resolver_bits=15)
LINEAR_FACTS = DriveFacts(torque_constant_nm_per_a=0.148, units="linear", position_lsb_rev=2.0**-15)
PLANTED = {  # name of the law -> what the plant is given
    "coulomb_drift": {"share": 0.6, "time_constant_s": 30.0},
    "elasticity": {"load_share": 0.4, "frequency_hz": 25.0, "damping": 0.06},
    "dead_zone": {"width_a": 0.2},
    "torque_ripple": {"share": 0.15, "order": 6.0},
    "current_lag": {"time_constant_s": 0.007},
    "position_dependent_friction": {"period_rev": 22.0, "wave_share": 0.4, "window_share": 0.0},
    "friction_ripple": {"share": 0.5, "order": 8.0},
}
SHOWN = 997  # every so many samples of a long signal are compared

# relative, of every number of a job
ROUNDED = 1e-9  # arithmetic without a search
DETERMINED = 1e-6  # what a search or a fit finds on given records
JUMPING = 1e-5  # finite differences over a simulated axis: a reversal comes or goes with a parameter, and they jump
NOISE = 0.05  # another noise of the sensor: six seeds of it moved these numbers by up to 3 %


class Job(NamedTuple):
    """One question."""

    tolerance: float
    answer: Callable[[Records], Answer]


def runs(*effects: EffectConfig) -> Runs:
    """Runs to fit and one to hold out, of an axis with effects."""
    plant = replace(random_plant(5), roughness_nm=2e-4, effects=effects)
    fit = [
        record(plant, identification_sequence(24.0, PERIOD_S, 0.5, 1.1, 0.1, 10.0), "identify"),
        record(plant, separating_recipe(PERIOD_S, 12.0, 80.0, 1), "recipe"),
    ]
    check = identification_sequence(20.0, PERIOD_S, 0.45, 1.0, 0.15, 8.0)
    return fit, [record(replace(plant, seed=99), check, "check")]


def written_once() -> Records:
    """Records that both processors are given."""
    return {
        "identify": excited(random_plant(3)),
        "effect": runs(EffectConfig("asymmetric_viscous", {"share": 0.4})),
        "no effect": runs(),
        **{name: runs(EffectConfig(name, values)) for name, values in PLANTED.items()},
    }


def profiles(_: Records) -> Answer:
    """Every so many samples of what is asked of an axis."""
    found = {
        "identify": identification_sequence(40.0, PERIOD_S, 0.4, 1.1, 0.05, 10.0),
        "recipe": separating_recipe(PERIOD_S, 14.0, 150.0, 1),
    }
    return {name: profile.values[::SHOWN] for name, profile in found.items()}


def open_loop(_: Records) -> Answer:
    """The model under a current, without sensor and loop."""
    current_a = identification_sequence(20.0, PERIOD_S, 0.5, 1.1, 0.1, 10.0).values
    states, _ = simulate(AXIS, AxisState(0.0, 0.0, REST), current_a, PERIOD_S, 1)
    return {"states": states[::SHOWN]}


def tuning(_: Records) -> Answer:
    """Gains of some axes."""
    return {
        f"J {factor:g}, Td {delay_s:g}": design(LinearAxis(factor * 9.4e-4, 0.003, delay_s, 0.148), 2.33)._asdict()
        for factor in (0.5, 1.0, 2.0)
        for delay_s in (0.0015, 0.003, 0.006)
    }


def identified(records: Records) -> Answer:
    """The model of an axis."""
    fit = fit_records(records["identify"])
    return {
        "value": dict(zip(PARAMETERS, fit.physical, strict=True)),
        "sd": dict(zip(PARAMETERS, fit.uncertainty.sd, strict=True)),
        "doubts": [doubt._asdict() for doubt in fit.uncertainty.doubts],
        "warnings": fit.warnings,
        "literal_loss": fit.literal_loss,
        "sensor_delay_s": fit.sensor_delay_s,
    }


def diagnosed(name: str, facts: DriveFacts = FACTS) -> Callable[[Records], Answer]:
    """What the model of an axis lacks."""
    return lambda records: _timeless(report(diagnose(*records[name], facts)))


def _timeless(content: Answer) -> Answer:
    # which shape of a law that nobody chose is best, and whether it is beside the base at all, may turn on rounding;
    # so may one that was examined and rejected
    left_out = ("seconds", "model_before", "model_after", "tried")
    kept = {key: value for key, value in content.items() if key not in left_out}
    kept["effects"] = [one for one in content["effects"] if not one["reason"]]
    return kept


def recovered(name: str) -> Callable[[Records], Answer]:
    """A law fitted to an axis that has the effect."""
    return lambda records: _recovered(records[name], name)


def _recovered(runs_: Runs, name: str) -> Answer:
    """The model that a search over this law alone ends at."""
    settings = DiagnosisSettings(without=frozenset(LAWS) - {name}, ablate=frozenset({"curves"}))
    found = diagnose(*runs_, FACTS, settings=settings)
    model = found.model_after or found.model_before
    return {
        "verdict": found.verdict,
        "found": {f.name: {n.name: n.value for n in f.parameters} for f in found.findings if f.accepted},
        "inertia": model.inertia_kg_m2.value,
        "friction": model.friction.model_dump(mode="json"),
        "error": found.fit_after.torque_rms_nm.value,
    }


def lag_of_its_own_run(_: Records) -> Answer:
    """What the data of a lag determine, on a run that this processor simulated."""
    found = _recovered(runs(EffectConfig("current_lag", PLANTED["current_lag"])), "current_lag")["found"]
    return {name: values.get("tau_s") for name, values in found.items()}


def controllers(_: Records) -> Answer:
    """Mean errors of the controllers on a run that this processor simulated."""
    case = case_of(read_scenario(SCENARIO), 1)
    found = {}
    for evaluation in run_case(case):
        assert evaluation.measures is not None, evaluation.fault_text
        figures = figures_of(evaluation.measures)
        found[evaluation.candidate] = {name: figures[name] for name in ("measured.ise", "measured.mae", "effort.rms_a")}
    return found


JOBS = {
    "profiles": Job(ROUNDED, profiles),
    "model in open loop": Job(ROUNDED, open_loop),
    "tuning": Job(DETERMINED, tuning),
    "identify": Job(JUMPING, identified),
    "diagnose, an effect": Job(DETERMINED, diagnosed("effect")),
    "diagnose, no effect": Job(DETERMINED, diagnosed("no effect")),
    "diagnose, linear axis": Job(DETERMINED, diagnosed("effect", LINEAR_FACTS)),
    **{f"recover {name}": Job(DETERMINED, recovered(name)) for name in PLANTED},
    "recover current_lag, own run": Job(NOISE, lag_of_its_own_run),
    "controllers, own run": Job(NOISE, controllers),
}


def chosen(words: Sequence[str]) -> dict[str, Job]:
    """The jobs whose names have one of the words in them; no words: all."""
    return {name: job for name, job in JOBS.items() if not words or any(word in name for word in words)}


def vector_features() -> list[str]:
    """Features of the processor that NumPy uses beyond its baseline."""
    return list(np.show_config(mode="dicts")["SIMD Extensions"].get("found", []))


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    return str(value)


def main(command: str, records: str, answers: str = "", *words: str) -> None:
    """`records FILE` writes what both are given; `answers FILE OUT [WORD...]` answers the jobs with such names."""
    if command == "records":
        Path(records).write_bytes(pickle.dumps(written_once()))
        return
    given = pickle.loads(Path(records).read_bytes())
    begin_s = time.monotonic()
    found = {
        "features": vector_features(),
        "answers": {name: job.answer(given) for name, job in chosen(words).items()},
        "seconds": time.monotonic() - begin_s,
    }
    Path(answers).write_text(json.dumps(found, default=_plain))


if __name__ == "__main__":
    main(*sys.argv[1:])
