"""Identification against known truth, coverage of its intervals, the published EMPS errors, and run time."""

from __future__ import annotations

import ctypes
import sys
import time
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from common import ROOT, Figures, Report, finish, interleaved, main, paired_ratio, parser, passes_of, shown
from in_c import Declarations, compile_c, compiler_version, packed

sys.path.insert(0, str(ROOT / "tests" / "identification"))

from rig import PERIOD_S, random_plant, record, truth
from rigid_regression import RigidSettings, fit_rigid, rigid_error_percent
from synthetic import AXIS

from fffo_drive.identification.coordinates import MODEL_PARAMETERS
from fffo_drive.identification.dataset import Record, load_record
from fffo_drive.identification.excitation import identification_sequence, separating_recipe
from fffo_drive.identification.facts import DriveFacts, read_facts
from fffo_drive.identification.fit import Fit, FitSettings, fit_records
from fffo_drive.model import friction
from fffo_drive.model.axis import AxisState, simulate_into
from fffo_drive.model.friction import REST
from fffo_drive.symbols import SYMBOLS
from fffo_drive.units import NORMAL_95

NAME = "identification"
PURPOSE = (
    "Fits of a simulated axis (single 2SEP surface of its own, current loop, 15-bit resolver, tracking loop, noise) "
    "with known truth, from the current chirp (60 s) and the recipe (about 105 s); the measured EMPS axis."
)
TRUTH_SETS = 10
TRUTH_LIMITS = dict.fromkeys(MODEL_PARAMETERS, 3.0) | {"stiffness_per_rev": 10.0, "stribeck_exponent": 10.0}
COVERAGE_SEEDS = 50
LEAST_COVERED, MOST_COVERED = 90.0, 99.0
WIDEST = 3.0
TIMED_S = 120.0
SLOWEST_S = 15.0
C_TARGET = 1.3
EMPS_PUBLISHED = {"rigid, fit": 4.0834, "rigid, held out": 5.9824, "by direction, fit": 3.1117}
EMPS_WITHIN = 0.1


class Truth(NamedTuple):
    """One fit against its truth, (parameters,) each."""

    error_percent: np.ndarray[Any, Any]
    deviation: np.ndarray[Any, Any]  # estimate minus truth
    sd: np.ndarray[Any, Any]


FACTS = DriveFacts(torque_constant_nm_per_a=0.148, rated_current_a=8.3)


def excitation(plant: Any, repeats: int) -> list[Record]:
    """Chirp and recipe on a plant."""
    chirp = identification_sequence(60.0, PERIOD_S, 0.3, 1.1, 0.01, 10.0)
    recipe = separating_recipe(PERIOD_S, 14.0, 150.0, repeats)
    return [record(plant, chirp, "identify"), record(plant, recipe, "recipe")]


def against_truth(plant: Any, repeats: int) -> Truth:
    """Fit a plant and compare."""
    fit: Fit = fit_records(excitation(plant, repeats), FitSettings(compare_literal=False), FACTS)
    expected = np.array(list(truth(plant).values()))
    count = len(MODEL_PARAMETERS)
    found = fit.physical[:count]
    return Truth(100.0 * (found / expected - 1.0), found - expected, fit.uncertainty.sd[:count])


def known_truth(report: Report, sets: int, progress: Any) -> None:
    """Random parameter sets: the worst error of each parameter."""
    found = []
    for seed in range(1, sets + 1):
        found.append(against_truth(random_plant(seed), 2))
        if progress is not None:
            progress(seed / sets)
    errors = np.abs([one.error_percent for one in found])
    for k, name in enumerate(MODEL_PARAMETERS):
        report.figure(
            f"worst error of {SYMBOLS[name].symbol} over {sets} axes", errors[:, k].max(), "%", TRUTH_LIMITS[name]
        )


def coverage(report: Report, seeds: int, progress: Any) -> None:
    """One axis, many noise seeds: how often the intervals hold the truth, and how wide they are."""
    found = []
    for seed in range(seeds):
        found.append(against_truth(random_plant(0, noise_seed=5000 + seed), 1))
        if progress is not None:
            progress((seed + 1) / seeds)
    deviation = np.array([one.deviation for one in found])
    sd = np.array([one.sd for one in found])
    covered = np.abs(deviation) < NORMAL_95 * sd
    spread = np.std(deviation, axis=0, ddof=1) if seeds > 1 else np.full(deviation.shape[1], np.nan)
    whole = 100.0 * float(covered.mean())
    report.figure("95 % intervals that contain the truth, all parameters", whole, "%")
    report.figure("their distance from 90 to 99 %", max(0.0, LEAST_COVERED - whole, whole - MOST_COVERED), "%", 0.0)
    width = np.median(sd, axis=0) / spread
    report.figure("widest median interval over the spread of the estimates", float(width.max()), "", WIDEST)
    rows = [
        [
            SYMBOLS[name].symbol,
            f"{100 * covered[:, k].mean():.0f} %",
            f"{width[k]:.2f}",
            f"{np.mean(sd[:, k]) / spread[k]:.2f}",
        ]
        for k, name in enumerate(MODEL_PARAMETERS)
    ]
    report.table(["parameter", "covered", "median width / spread", "mean width / spread"], rows)
    report.notes.append(
        f"Coverage over {seeds} noise seeds of one axis. Spread: of the estimates over the seeds. The intervals also "
        "include the shift of the estimates when the fit is repeated at half the observer's bandwidth."
    )


def emps(report: Report) -> None:
    """The published errors, by the authors' metric."""
    data = ROOT.parent / "shared" / "data" / "emps"
    if not data.is_dir():
        report.notes.append("EMPS: the measured files are not beside this checkout.")
        return
    facts = read_facts(ROOT / "tests" / "identification" / "emps.yaml")
    fitted, held = (load_record(data / f"{name}.mat", facts) for name in ("DATA_EMPS", "DATA_EMPS_PULSES"))
    rigid = fit_rigid(fitted)
    errors = {
        "rigid, fit": rigid.error_percent,
        "rigid, held out": rigid_error_percent(held, rigid.parameters),
        "by direction, fit": fit_rigid(fitted, RigidSettings(directional=True)).error_percent,
    }
    for name, published in EMPS_PUBLISHED.items():
        what = f"EMPS {name}: {errors[name]:.4f} %, off {published} % by"
        report.figure(what, abs(errors[name] - published), "points", EMPS_WITHIN)
    settings = RigidSettings(hold=True)
    base = fit_rigid(fitted, settings)
    report.notes.append(
        f"EMPS with the half-sample hold of the command in the base: fit {base.error_percent:.4f} %, held out "
        f"{rigid_error_percent(held, base.parameters, settings):.4f} %. Filter: Butterworth, order 4 in all (2 each "
        "way), 100 Hz, on the position; first 49 samples dropped; Chebyshev decimation by 10 without phase."
    )


def timing(report: Report, repeats: int) -> None:
    """A fit of 120 s, warm."""
    chirp, recipe = excitation(random_plant(0), 1)
    samples = round((TIMED_S - chirp.duration_s) / PERIOD_S)
    columns = ("current_a", "position_rev", "velocity_rps", "reference_rps")
    cut = {name: getattr(recipe, name)[:samples] for name in columns}
    records = [chirp, replace(recipe, **cut)]
    spent = []
    for _ in range(repeats + 1):
        begin = time.perf_counter()
        fit_records(records)
        spent.append(time.perf_counter() - begin)
    length = sum(r.duration_s for r in records)
    report.figure(f"fit of {length:.0f} s at 2 kHz, both Stribeck curves", float(np.median(spent[1:])), "s", SLOWEST_S)


def against_c(report: Report, passes: int, progress: Any) -> None:
    """The simulation of the model and the same steps in C."""
    current = identification_sequence(20.0, PERIOD_S, 0.3, 1.1, 0.05, 10.0).values
    state = AxisState(0.0, 0.0, REST)
    declarations = Declarations()
    declarations.constants(friction, "OMEGA_", "STRIBECK_FLOOR", "PRESLIDING_OVER")
    declarations.record(AXIS)
    declarations.record(state)
    library = compile_c("axis.c", declarations.text)
    output = {language: np.zeros((current.size, 3)) for language in ("numba", "C")}

    def in_numba() -> Figures:
        begin = time.perf_counter()
        simulate_into(AXIS, state, current, PERIOD_S, 1, output["numba"])
        return {"s": time.perf_counter() - begin}

    def in_c() -> Figures:
        records = [ctypes.create_string_buffer(packed(record)) for record in (AXIS, state)]
        pointer = ctypes.c_void_p(output["C"].ctypes.data)
        arguments = (ctypes.c_void_p(current.ctypes.data), ctypes.c_int64(current.size), ctypes.c_double(PERIOD_S))
        begin = time.perf_counter()
        library.simulate(*records, *arguments, ctypes.c_int64(1), pointer)
        return {"s": time.perf_counter() - begin}

    in_numba(), in_c()
    found = interleaved({"numba": in_numba, "C": in_c}, passes, progress)
    report.ratio("simulation over the same in C", paired_ratio(found["numba"]["s"], found["C"]["s"]), C_TARGET)
    difference = float(np.abs(output["numba"] - output["C"]).max())
    report.figure("largest difference of the two", difference, "", 1e-6)
    report.notes.append(f"C: {compiler_version()}")


def run() -> int:
    """Everything, or a sample of it."""
    options = parser(NAME, PURPOSE, 41, 5).parse_args()
    report = Report(NAME, PURPOSE)
    with shown("simulation in C") as progress:
        against_c(report, passes_of(options), progress)
    emps(report)
    timing(report, 1 if options.sample else 3)
    with shown("known truth") as progress:
        known_truth(report, 1 if options.sample else TRUTH_SETS, progress)
    with shown("coverage") as progress:
        coverage(report, 2 if options.sample else COVERAGE_SEEDS, progress)
    return finish(report, options)


if __name__ == "__main__":
    main(run)
