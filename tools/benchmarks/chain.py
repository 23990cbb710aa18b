"""The chain from commissioning to a tuned run on random axes: commission, excite, identify, tune, run; at rest too.

Where `commission` warns that the axis is no single rigid inertia, `diagnose` comes before `tune`, as both advise.

  .venv/bin/python tools/benchmarks/chain.py [--axes N] [--first NUMBER] [--rows FILE]

Each axis has every number, its delay and its noise spread by half, one of five friction laws, one to three effects, a
resolver or an encoder (tools/trial_axes/random_axis.wide_axis). Axes that no controller can bring to rest are
counted apart (tools/trial_axes/passivity). The chain gets only the torque constant, 5 % wrong:
`commission` begins with an assumed inertia and delay; `tune` designs for the longer of its delay and the fitted one.

A thousand axes take over an hour. With `--rows` the results are saved after every batch, and the same command resumes
after an interruption. The table names the commits that the rows were measured at.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from common import RESULTS, ROOT, commit, made_by, progress_bar
from trial_axes.passivity import comes_to_rest
from trial_axes.random_axis import RandomAxis, wide_axis
from trial_axes.robustness import CYCLE, HUNTING, STABLE, TRIPPED, UNSTABLE, probe

from fffo_drive.arrays import Floats
from fffo_drive.commissioning.bounds import make_bounds
from fffo_drive.commissioning.procedure import commission
from fffo_drive.commissioning.record import FAILED, DeclaredFacts
from fffo_drive.config.axis import controller_config
from fffo_drive.config.commissioning import NOT_COMMISSIONED, Commissioned, commissioned_in
from fffo_drive.config.scenario import case_of, read_scenario
from fffo_drive.control.controller import ControllerConfig
from fffo_drive.control.envelope import TRIP_NONE
from fffo_drive.control.friction_observer import TOGGLE_FEEDFORWARD, TOGGLE_OFF
from fffo_drive.control.position_hold import NO_HOLD
from fffo_drive.control.reference import MODE_VELOCITY, Profile, piecewise_linear
from fffo_drive.control.stability import linear_axis
from fffo_drive.diagnosis.diagnose import diagnose
from fffo_drive.documents import DocumentError
from fffo_drive.drive.cia402 import STATUS_INTERNAL_LIMIT
from fffo_drive.drive.simulated.in_process import SimulatedDrive
from fffo_drive.evaluation.campaign import Candidate, Case, simulate, warm_up
from fffo_drive.evaluation.workers import over_cores
from fffo_drive.identification.dataset import DataError, Record, where_command_acts
from fffo_drive.identification.excitation import frequency_response_chirp, identification_sequence
from fffo_drive.identification.facts import DriveFacts
from fffo_drive.identification.fit import FitSettings, fit_records
from fffo_drive.identification.results import model_file
from fffo_drive.identification.tuning import Wish
from fffo_drive.model.parameters import ModelFile
from fffo_drive.recording.ring_reader import RingReader
from fffo_drive.runtime.session import Session
from fffo_drive.workflows.tune import needs_diagnosis, tune

SCENARIO = ROOT / "configs" / "scenarios" / "paper.yaml"
FRESH = 3000  # no choice was made on axes from here on
TORQUE_CONSTANT_SHARE = 0.05  # by which the data sheet is wrong, with a random sign
RATED_A = 8.3
CHIRP_S = 40.0
CHIRP_A = (0.3, 1.1)  # with the torque constant of the nominal axis
MORE_CURRENT = 2.0  # times as much where `identify` asks for it: axes 8369 and 8764 moved in 4 and 2 % of the chirp
SWEEP_S, SWEEP_A, SWEEP_HZ = 30.0, 0.8, (0.1, 50.0)  # what determines the delay
REST_S = 6.8
CREEP_FROM_S, CREEP_TO_S = 0.7, 5.7  # after the stop: five seconds, when the contact has unloaded
# over which a position is averaged, with the weights of a Hann window: a periodic disturbance is no creep. One of
# 7.3 Hz shook axis 7003 by 37 counts to each side, and the plain mean over 0.2 s, 1.46 periods, left 6 of them
CREEP_MEAN_S = 1.0
MOST_CREEP_COUNTS = 5.0  # of a 15-bit resolver
MOST_SWING_COUNTS = 20.0  # shaken by its own effects, an axis at rest swings by some counts
SWING_S = 2.0  # the last of the rest: a contact that rings is no creep, and a mean over its periods hides it
COUNTS_PER_REV = 2.0**15
CRASHED = "crashed"
BATCH_AXES = 10  # between two writes of the rows


class Outcome(NamedTuple):
    """Result for an axis."""

    number: int
    law: str
    effects: tuple[str, ...]
    passive: bool
    refused: str  # why the chain gave no gains; empty when it did
    verdict: str  # of trial_axes.robustness, with the tuned gains
    nominal: str  # ... with those of the scenario
    creep_counts: float  # nan where it was not run
    nominal_creep_counts: float
    unheld: str  # verdict with the tuned gains, the position not held at rest
    unheld_creep_counts: float
    phase_deg: float  # margin of the design
    rest_share: float
    seconds: float
    commissioned_delay_s: float  # less what is true; nan where the chain ended before
    fitted_delay_s: float  # ... of identify
    commit: str  # that it was measured at
    swing_counts: float = math.nan  # peak to peak at rest; nan in rows of earlier code as well


class Job(NamedTuple):
    """An axis and the scenario's case."""

    axis: RandomAxis
    case: Case


def declared_nm_per_a(axis: RandomAxis) -> float:
    """The torque constant of the data sheet."""
    wrong = float(np.random.default_rng([axis.number, 0xC]).choice((-1.0, 1.0))) * TORQUE_CONSTANT_SHARE
    return axis.plant.torque_constant_nm_per_a * (1.0 + wrong)


def commission_axis(case: Case, assumed: ModelFile, constant_nm_per_a: float) -> Commissioned:
    """What `commission` measures with the assumed numbers of a new axis. ValueError: it has not passed."""
    guesses = {
        key: getattr(assumed, key).model_copy(update={"source": "assumed"}) for key in ("inertia_kg_m2", "delay_s")
    }
    model = assumed.model_copy(update={"torque_constant_nm_per_a": constant_nm_per_a, **guesses})
    facts = DeclaredFacts(drive_kind="simulated", torque_constant_nm_per_a=constant_nm_per_a)
    drive = SimulatedDrive(case.plant, case.device)
    found = commission(drive, case.session, model, facts, make_bounds(case.session.envelope)).checks
    failed = [check for check in found if check.verdict == FAILED]
    if failed:
        raise ValueError(f"commission: {failed[0].name}: {failed[0].text}")
    return commissioned_in(found)


def excite(case: Case, profile: Profile, controller: ControllerConfig, constant_nm_per_a: float) -> Record:
    """A run of the profile from power-on, as a record."""
    drive = SimulatedDrive(case.plant, case.device)
    drive.connect()
    session = Session(drive, case.session._replace(controller=controller))
    session.run_profile(profile, TOGGLE_OFF)
    rows = RingReader(session.ring).read().rows
    rows = rows[rows["profile_sample"] >= 0]
    columns = {name: np.ascontiguousarray(rows[name]) for name in ("position_rev", "velocity_rps")}
    limited = rows["statusword"] & STATUS_INTERNAL_LIMIT != 0
    record = Record(
        name=profile.name, path=Path(profile.name), period_s=profile.period_s,
        torque_constant_nm_per_a=constant_nm_per_a, current_a=np.ascontiguousarray(rows["current_command_a"]),
        reference_rps=None, lsb_rev=2.0**-case.plant.resolver.bits, breaks=(), digest="",
        limited=limited if limited.any() else None, **columns,
    )  # fmt: skip
    return where_command_acts(record)


def excitations(
    case: Case, controller: ControllerConfig, constant_nm_per_a: float, factor: float = 1.0
) -> list[Record]:
    """Runs of the paper's two chirps of current, `factor` times as large."""
    scale = factor * 0.148 / constant_nm_per_a
    period_s = case.session.loop.period_ns * 1e-9
    chirp = identification_sequence(CHIRP_S, period_s, scale * CHIRP_A[0], scale * CHIRP_A[1], 0.01, 10.0)
    fast = frequency_response_chirp(SWEEP_S, period_s, scale * SWEEP_A, *SWEEP_HZ)
    return [excite(case, profile, controller, constant_nm_per_a) for profile in (chirp, fast)]


def facts_of(constant_nm_per_a: float) -> DriveFacts:
    """What the name plate says."""
    return DriveFacts(torque_constant_nm_per_a=constant_nm_per_a, rated_current_a=RATED_A)


def identified(
    case: Case, number: int, controller: ControllerConfig, constant_nm_per_a: float
) -> tuple[ModelFile, list[Record]]:
    """The model of the axis, and the runs that it is from: with twice the current where `identify` asks for more (Fc in
    doubt).
    """
    for factor in (1.0, MORE_CURRENT):
        records = excitations(case, controller, constant_nm_per_a, factor)
        fit = fit_records(records, FitSettings(compare_literal=False), facts_of(constant_nm_per_a))
        if all(doubt.name != "coulomb_nm" for doubt in fit.uncertainty.doubts):
            break
    return model_file(fit, records, f"axis {number}"), records


def diagnosed_where_advised(
    records: list[Record], constant_nm_per_a: float, model: ModelFile, measured: Commissioned
) -> ModelFile:
    """Where `tune` advises it, the model with what `diagnose` finds on the runs of `identify`; else, and where it finds
    nothing or cannot tell, the model as it is.
    """
    if not needs_diagnosis(model, measured):
        return model
    try:
        found = diagnose(records, [], facts_of(constant_nm_per_a))
    except DataError:
        return model
    return model if found.model_after is None else found.model_after


def tuned(base: Any, model: ModelFile, measured: Commissioned) -> tuple[Candidate, float, float]:
    """PI+FFFO+ with the gains that `tune` writes; phase margin, share at rest. DocumentError: refused."""
    found = tune(model, linear_axis(model, base.loop.period_s), Wish(), measured).design
    section = base.controller
    observer = section.observer.model_copy(
        update={"gain_nm_per_rev": found.gains.observer_nm_per_rev, "learns_in": "integral"}
    )
    at_rest = {
        "gain_share": found.gains.rest_share,
        "release_friction": True,
        "hold_a_per_rev_s": found.gains.hold_a_per_rev_s,
    }
    rest = section.at_rest.model_copy(update=at_rest)
    feedforward = section.feedforward.model_copy(update={"inertia": True, "preview": True, "delay_aware": True})
    changed = section.model_copy(
        update={
            "proportional_a_per_rps": found.gains.proportional_a_per_rps,
            "integral_a_per_rev": found.gains.integral_a_per_rev,
            "observer": observer,
            "at_rest": rest,
            "feedforward": feedforward,
        }
    )
    axis_file = base.model_copy(update={"controller": changed})
    controller = controller_config(axis_file, model)
    return Candidate("tuned", TOGGLE_FEEDFORWARD, controller), found.margins_observer.phase_deg, found.gains.rest_share


def at_rest_counts(case: Case, candidate: Candidate) -> tuple[float, float]:
    """How far the shaft goes in five seconds at rest, and how far it swings in the last `SWING_S`; counts of 15 bits,
    nan where the envelope tripped.
    """
    period_s = case.session.loop.period_ns * 1e-9
    times_s = np.array([0.0, 0.2, 0.3, 1.5, 1.6, 1.6 + REST_S])
    profile = piecewise_linear("stop", MODE_VELOCITY, period_s, times_s, np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0]))
    rows, trip = simulate(case._replace(profile=profile), candidate)
    if trip != TRIP_NONE:
        return math.nan, math.nan
    rows = rows[(rows["profile_sample"] >= 0) & (rows["profile_sample"] < profile.values.size)]
    velocity_rps = rows["true_velocity_rps"]
    swing_rev = np.ptp(np.cumsum(velocity_rps[-round(SWING_S / period_s) :]) * period_s)
    return crept_counts(velocity_rps, round(1.6 / period_s), period_s), float(swing_rev) * COUNTS_PER_REV


def crept_counts(velocity_rps: Floats, stop: int, period_s: float) -> float:
    """How far the shaft goes between two places, five seconds apart, after the stop at a sample; counts of 15 bits."""
    travel_rev = np.cumsum(velocity_rps) * period_s
    weights = np.hanning(round(CREEP_MEAN_S / period_s) + 2)[1:-1]
    ends = []
    for after_s in (CREEP_FROM_S, CREEP_TO_S):
        first = stop + round(after_s / period_s)
        ends.append(float(np.average(travel_rev[first : first + weights.size], weights=weights)))
    return abs(ends[1] - ends[0]) * COUNTS_PER_REV


def run_job(job: Job) -> Outcome:
    """The chain on one axis."""
    began = time.perf_counter()
    axis = job.axis
    case = job.case._replace(plant=axis.plant)
    scenario = read_scenario(SCENARIO)
    nominal = next(c for c in job.case.candidates if c.name == "pi+fffo+")
    passive = comes_to_rest(axis.plant)
    true_s = axis.plant.delay_s - 0.5 * case.session.loop.period_ns * 1e-9  # without the hold
    as_today = probe(case, nominal).verdict, at_rest_counts(case, nominal)[0]
    candidate, phase_deg, share, refused = None, math.nan, math.nan, ""
    measured, fitted_s = NOT_COMMISSIONED, math.nan
    constant_nm_per_a = declared_nm_per_a(axis)
    try:
        measured = commission_axis(case, scenario.model, constant_nm_per_a)
        model, records = identified(case, axis.number, nominal.controller, constant_nm_per_a)
        fitted_s = model.delay_s.value
        model = diagnosed_where_advised(records, constant_nm_per_a, model, measured)
        candidate, phase_deg, share = tuned(scenario.axis, model, measured)
    except (ValueError, DocumentError) as error:
        refused = str(error).splitlines()[0]
    except Exception as error:  # a fault of the program: counted, so that an hour's work is not lost with it
        refused = f"{CRASHED}: {type(error).__name__}: {error}"
    verdict, creep, swing = (CRASHED if refused.startswith(CRASHED) else "refused", math.nan, math.nan)
    unheld = verdict, math.nan
    if candidate is not None:
        verdict, (creep, swing) = probe(case, candidate).verdict, at_rest_counts(case, candidate)
        law = candidate.controller
        without = candidate._replace(controller=law._replace(rest=law.rest._replace(hold=NO_HOLD)))
        unheld = probe(case, without).verdict, at_rest_counts(case, without)[0]
    return Outcome(
        axis.number, axis.law, axis.effects, passive, refused, verdict, as_today[0], creep, as_today[1],
        *unheld, phase_deg, share, time.perf_counter() - began,
        math.nan if measured.delay_s is None else measured.delay_s - true_s, fitted_s - true_s, commit(),
        swing,
    )  # fmt: skip


def table(found: list[Outcome]) -> list[str]:
    """Verdicts, creep, and every axis that is not stable."""
    passive = [one for one in found if one.passive]
    lines = [
        f"{len(found)} axes, numbers {found[0].number} to {found[-1].number}; {len(found) - len(passive)} that no "
        "controller can bring to rest are omitted below.",
        "",
        "| gains | "
        + " | ".join(("stable", "hunting", "limit cycle", "unstable", "tripped", "refused", CRASHED))
        + " | creep "
        f"over {MOST_CREEP_COUNTS:g} counts in 5 s | median, 95 % quantile of it |",
        "|---|" + "---|" * 9,
    ]
    verdicts = (STABLE, HUNTING, CYCLE, UNSTABLE, TRIPPED, "refused", CRASHED)
    for name, which, creep in (
        ("as in the scenario", "nominal", "nominal_creep_counts"),
        ("identified and tuned, position not held at rest", "unheld", "unheld_creep_counts"),
        ("identified and tuned", "verdict", "creep_counts"),
    ):
        counted = Counter(getattr(one, which) for one in passive)
        creeps = np.array([getattr(one, creep) for one in passive])
        known = creeps[np.isfinite(creeps)]
        cells = [str(counted[verdict]) for verdict in verdicts]
        beyond = f"{int(np.sum(known > MOST_CREEP_COUNTS))} of {known.size}"
        median, late = np.quantile(known, [0.5, 0.95])
        lines.append(f"| {name} | " + " | ".join(cells) + f" | {beyond} | {median:.1f}, {late:.1f} |")
    lines += ["", "Passive axes on which the tuned loop is not stable, or was refused:", ""]
    lines += ["| axis | friction | effects | verdict | margin | share at rest |", "|---|---|---|---|---|---|"]
    for one in passive:
        if one.verdict != STABLE:
            said = one.refused or one.verdict
            lines.append(
                f"| {one.number} | {one.law} | {', '.join(one.effects)} | {said} | {one.phase_deg:.0f} deg "
                f"| {one.rest_share:.2f} |"
            )
    creeping = [one for one in passive if one.verdict == STABLE and one.creep_counts > MOST_CREEP_COUNTS]
    lines += ["", "Stable ones that creep, by friction law: " + _by_law(creeping) + ".", ""]
    lines += _creeping(creeping)
    lines += _swinging(passive)
    lines += ["Measured delay less the true one, ms (5 %, median, 95 % quantile): " + _delays(passive) + ".", ""]
    return lines


def read_rows(path: Path) -> list[Outcome]:
    """What `add_rows` wrote."""
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return [Outcome(**row | {"effects": tuple(row["effects"])}) for row in rows]


def add_rows(path: Path, found: Sequence[Outcome]) -> None:
    """Append one JSON line per axis (NaN as Python's json writes it)."""
    with path.open("a", encoding="utf-8") as file:
        file.writelines(json.dumps(one._asdict()) + "\n" for one in found)


def _delays(found: list[Outcome]) -> str:
    """Without the axes whose effect is a delay: their truth is another one."""
    texts = []
    for name, which in (("commission", "commissioned_delay_s"), ("identify", "fitted_delay_s")):
        errors_s = np.array([getattr(one, which) for one in found if "delay" not in one.effects])
        low, median, high = 1e3 * np.nanquantile(errors_s, [0.05, 0.5, 0.95])
        texts.append(f"{name} {low:.2f}, {median:.2f}, {high:.2f}")
    return "; ".join(texts)


def _creeping(found: list[Outcome]) -> list[str]:
    if not found:
        return []
    lines = ["| axis | friction | effects | creep in counts, position not held | held |", "|---|---|---|---|---|"]
    lines += [
        f"| {one.number} | {one.law} | {', '.join(one.effects)} | {one.unheld_creep_counts:.1f} "
        f"| {one.creep_counts:.1f} |"
        for one in found
    ]
    return [*lines, ""]


def _swinging(found: list[Outcome]) -> list[str]:
    """The stable axes that ring at rest, of those whose swing is known."""
    known = [one for one in found if math.isfinite(one.swing_counts)]
    if not known:
        return []
    ringing = [one for one in known if one.verdict == STABLE and one.swing_counts > MOST_SWING_COUNTS]
    listed = ", ".join(f"{one.number} ({one.law}, {one.swing_counts:.0f})" for one in ringing) or "none"
    return [
        f"Stable ones that swing by more than {MOST_SWING_COUNTS:g} counts peak to peak in the last {SWING_S:g} s at "
        f"rest, of {len(known)} where it was measured: {listed}.",
        "",
    ]


def _by_law(found: list[Outcome]) -> str:
    counted = Counter(one.law for one in found)
    return ", ".join(f"{law} {count}" for law, count in counted.most_common()) or "none"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run everything and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--axes", type=int, default=1000)
    parser.add_argument("--first", type=int, default=FRESH, help="number of the first random axis")
    parser.add_argument("--out", type=Path, default=RESULTS / "chain.md")
    parser.add_argument("--rows", type=Path, help="save results here (JSON lines), and resume from it")
    options = parser.parse_args(arguments)
    case = case_of(read_scenario(SCENARIO), 1)
    warm_up(case)
    found = read_rows(options.rows) if options.rows is not None and options.rows.is_file() else []
    known = {one.number for one in found}
    numbers = [n for n in range(options.first, options.first + options.axes) if n not in known]
    with progress_bar("axes") as progress:
        for part in (numbers[k : k + BATCH_AXES] for k in range(0, len(numbers), BATCH_AXES)):
            new = over_cores(run_job, (Job(wide_axis(case.plant, number), case) for number in part))
            found += new
            if options.rows is not None:
                add_rows(options.rows, new)
            if progress is not None:
                progress((len(found) - len(known)) / len(numbers))
    found.sort(key=lambda one: one.number)
    commits = ", ".join(sorted({one.commit for one in found}))
    lines = [
        "# chain",
        "",
        "The chain on random axes: commission, excite (70 s of the paper's chirps of current), identify, tune, run.",
        "Where commissioning finds no single rigid inertia, diagnose comes before tune, as tune advises.",
        "Only the torque constant is given, 5 % wrong.",
        "",
        *table(found),
        f"{made_by('chain.py', commits)} {np.median([one.seconds for one in found]):.1f} s an axis.",
    ]
    options.out.write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
