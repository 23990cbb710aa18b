"""The chain from commissioning to a tuned run on random axes: commission, excite, identify, tune, run; at rest too.

Where `commission` warns that the axis is no single rigid inertia, `diagnose` comes before `tune`, as both advise.

  .venv/bin/python tools/benchmarks/chain.py [--axes N] [--first NUMBER] [--typed] [--rows FILE]

Each axis has every number, its delay and its noise spread by half, one of five friction laws, one to three effects, a
resolver or an encoder; a third has an elastic load (tools/trial_axes/random_axis.wide_axis). Axes that no controller
can bring to rest are counted apart (tools/trial_axes/passivity). The chain gets only the torque constant, 5 % wrong:
`commission` begins with an assumed inertia and delay. The axis file that `tune` writes is run as it is.

With --typed the commands themselves are run, each a process of its own, and the table is chain_typed.md. On the first
axes the same chain then runs in one process on the same recordings, and all files are compared byte for byte. Without,
every file is written by the function that the command writes it with (chain_files.py), in one process.

With `--rows` the results are saved after every batch, and the same command resumes after an interruption. The table
names the commits that the rows were measured at.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import shutil
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from chain_files import AXIS, IDENTIFIED, PROFILES, RANGED, TUNED, Chain, TypedChain
from common import RESULTS, ROOT, commit, made_by, progress_bar
from trial_axes.passivity import comes_to_rest
from trial_axes.random_axis import ELASTIC_EVERY, ELASTICITY, RandomAxis, wide_axis
from trial_axes.robustness import CYCLE, HUNTING, STABLE, TRIPPED, UNSTABLE, probe

from fffo_drive.arrays import Floats
from fffo_drive.config.axis import TOGGLES, controller_config, model_of, read_axis
from fffo_drive.config.scenario import case_of, read_scenario
from fffo_drive.control.envelope import TRIP_NONE
from fffo_drive.control.reference import MODE_VELOCITY, piecewise_linear
from fffo_drive.documents import DocumentError
from fffo_drive.evaluation.campaign import Candidate, Case, simulate, warm_up
from fffo_drive.evaluation.workers import over_cores
from fffo_drive.model.parameters import read_model
from fffo_drive.recording.errors import RecordingError
from fffo_drive.recording.reader import read_run

SCENARIO = ROOT / "configs" / "scenarios" / "paper.yaml"
AXES, TYPED_AXES = 1000, 120
FRESH = 20_000  # no choice was made on axes from here on
INERTIAS = (1.0 / 3.0, 3.0)  # times the model's, as declared with `tune --inertia-range`
COMPARED = 3  # of the typed ones: the same in one process
TORQUE_CONSTANT_SHARE = 0.05  # by which the data sheet is wrong, with a random sign
REST_S = 6.8
CREEP_FROM_S, CREEP_TO_S = 0.7, 5.7  # after the stop: five seconds, when the contact has unloaded
# over which a position is averaged, with the weights of a Hann window: a periodic disturbance is no creep. One of
# 7.3 Hz shook axis 7003 by 37 counts to each side, and the plain mean over 0.2 s, 1.46 periods, left 6 of them
CREEP_MEAN_S = 1.0
MOST_CREEP_COUNTS = 5.0  # of a 15-bit resolver
MOST_SWING_COUNTS = 20.0  # shaken by its own effects, an axis at rest swings by some counts
SWING_S = 2.0  # the last of the rest: a contact that rings is no creep, and a mean over its periods hides it
COUNTS_PER_REV = 2.0**15
CRASHED, REFUSED = "crashed", "refused"
REFUSALS = (ValueError, DocumentError, RecordingError)  # what a command ends with and says why
BATCH_AXES = 10  # between two writes of the rows
# beginnings of warnings that are no word about shaking, hunting or tripping: of the design, and of what `commission`
# finds other than in the assumed model
NO_WORD = (
    "L is ",
    "friction damping may vary",
    "designed for the delay",
    "torque_per_inertia: ",
    "delay: ",
    "velocity_age: ",
)
A_DATE = re.compile(rb"\d{4}-\d\d-\d\d[T ]\d\d:\d\d[\d:.+Z]*")


class Outcome(NamedTuple):
    """Result for an axis."""

    number: int
    law: str
    effects: tuple[str, ...]
    elastic: str  # the elastic load; empty without
    passive: bool
    refused: str  # why the chain gave no gains; empty when it did
    warned: tuple[str, ...]  # what the user was told before anything ran with the tuned gains
    verdict: str  # of trial_axes.robustness, with the tuned gains
    creep_counts: float  # nan where it was not run
    swing_counts: float  # peak to peak at rest
    ran: str  # what the run of the tuned file's own profile ended with; empty: with its end
    phase_deg: float  # margin of the design
    rest_share: float
    commissioned_delay_s: float  # less what is true; nan where the chain ended before
    fitted_delay_s: float  # ... of identify
    cpu_s: float  # commands and judgement
    commit: str  # that it was measured at
    range_refused: str = ""  # why there are no gains for `INERTIAS` times the model's inertia; empty where there are
    range_warned: tuple[str, ...] = ()
    light: str = ""  # verdict with these gains and the least of these inertias
    heavy: str = ""  # ... the largest
    differing: str | None = None  # files that the chain in one process writes otherwise; None: not compared

    @property
    def kind(self) -> str:
        """What the table counts it as."""
        if self.refused:
            return CRASHED if self.refused.startswith(CRASHED) else REFUSED
        if self.verdict == STABLE and (self.ran or math.isnan(self.creep_counts)):
            return TRIPPED
        return self.verdict


class Job(NamedTuple):
    """An axis and the scenario's case."""

    axis: RandomAxis
    case: Case
    typed: bool = False
    compared: bool = False


def declared_nm_per_a(axis: RandomAxis) -> float:
    """The torque constant of the data sheet."""
    wrong = float(np.random.default_rng([axis.number, 0xC]).choice((-1.0, 1.0))) * TORQUE_CONSTANT_SHARE
    return axis.plant.torque_constant_nm_per_a * (1.0 + wrong)


def tuned_candidate(chain: Chain, directory: str = TUNED) -> Candidate:
    """What `run` makes of the axis file that `tune` wrote."""
    path = chain.place / directory / AXIS
    axis = read_axis(path)
    return Candidate(directory, TOGGLES[axis.controller.observer.toggle], controller_config(axis, model_of(path, axis)))


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
    began_s = _processor_s()
    axis = job.axis
    case = job.case._replace(plant=axis.plant)
    passive = comes_to_rest(axis.plant)
    true_s = axis.plant.delay_s - 0.5 * case.session.loop.period_ns * 1e-9  # without the hold
    verdict, creep, swing, refused, ran = "", math.nan, math.nan, "", ""
    phase_deg, share, loaded = math.nan, math.nan, Loaded()
    differing: str | None = None
    with TemporaryDirectory(prefix="chain_") as place:
        chain = TypedChain(Path(place)) if job.typed else Chain(Path(place))
        try:
            found = chain.type(axis.plant, declared_nm_per_a(axis))
            warned = words_of(chain.warnings)
        except REFUSALS as error:
            refused, warned = str(error).splitlines()[0], ()
        except Exception as error:  # a fault of the program: counted, so that an hour's work is not lost with it
            refused, warned = f"{CRASHED}: {type(error).__name__}: {error}", ()
        else:
            phase_deg, share = found["margins_observer"]["phase_deg"], found["gains"]["rest_share"]
            candidate = tuned_candidate(chain)
            verdict, (creep, swing) = probe(case, candidate).verdict, at_rest_counts(case, candidate)
            ran = ended_with(lambda: chain.run("tuned_run", chain.tuned))
            differing = differing_files(chain, axis) if job.compared else None
            loaded = with_range(case, chain)
        measured_s, fitted_s = chain.delays_s()
        refused, ran = (text.replace(f"{place}/", "") for text in (refused, ran))
    elastic = next((effect.parameters for effect in axis.plant.effects if effect.name == ELASTICITY), None)
    return Outcome(
        axis.number, axis.law, axis.effects, "" if elastic is None else elastic_text(elastic), passive, refused, warned,
        verdict, creep, swing, ran, phase_deg, share, measured_s - true_s, fitted_s - true_s,
        _processor_s() - began_s, commit(), *loaded, differing,
    )  # fmt: skip


class Loaded(NamedTuple):
    """What an Outcome has of the range of inertia."""

    range_refused: str = ""
    range_warned: tuple[str, ...] = ()
    light: str = ""
    heavy: str = ""


def with_range(case: Case, chain: Chain) -> Loaded:
    """The axis with each of `INERTIAS` times its model's inertia, under the gains for this range."""
    model = read_model(chain.model())
    ends = [share * model.inertia_kg_m2.value for share in INERTIAS]
    told = len(chain.warnings)
    try:
        chain.tune_range(*ends)
    except REFUSALS as error:
        return Loaded(str(error).splitlines()[0])
    warned = words_of(chain.warnings[told:])
    candidate = tuned_candidate(chain, RANGED)
    verdicts = []
    for inertia_kg_m2 in ends:
        loaded = case._replace(plant=replace(case.plant, inertia_kg_m2=inertia_kg_m2))
        verdict = probe(loaded, candidate).verdict
        tripped = verdict == STABLE and math.isnan(at_rest_counts(loaded, candidate)[0])
        verdicts.append(TRIPPED if tripped else verdict)
    return Loaded("", warned, *verdicts)


def words_of(warnings: Sequence[str]) -> tuple[str, ...]:
    """Those that say what may become of the axis."""
    return tuple(text for text in warnings if not text.startswith(NO_WORD))


def elastic_text(values: Mapping[str, float]) -> str:
    """Share, frequency and damping of an elastic load."""
    share, frequency_hz, damping = (values.get(name, math.nan) for name in ("load_share", "frequency_hz", "damping"))
    return f"{share:.2f} behind {frequency_hz:.0f} Hz, damping {damping:.3f}"


def ended_with(run: Callable[[], object]) -> str:
    """What a run of the tuned file is refused or ends with; empty for neither."""
    try:
        run()
    except REFUSALS as error:
        return str(error).splitlines()[0]
    return ""


def differing_files(typed: Chain, axis: RandomAxis) -> str:
    """Files that the same chain in one process writes otherwise than the typed commands did, dates aside.

    A recording has the date of its run, and a model the hash of its recordings: their rows are compared, and the models
    are made of the typed ones.
    """
    with TemporaryDirectory(prefix="chain_") as place:
        made = Chain(Path(place))
        made.new_axis(axis.plant, declared_nm_per_a(axis))
        made.commission()
        for path in typed.place.glob("*.yaml"):
            if path.stem in PROFILES:
                shutil.copy(path, made.place)  # the amplitudes that the user found
        found = []
        for name in PROFILES:
            rows = [read_run(path).rows for path in (made.run_as_advised(name), typed.place / f"{name}.mcap")]
            if not all(np.array_equal(rows[0][one], rows[1][one], equal_nan=True) for one in rows[0].dtype.names):
                found.append(f"rows of {name}")
            shutil.copy(typed.place / f"{name}.mcap", made.place)
        made.identify([made.place / log.name for log in typed.logs])
        made.diagnose_where_advised()
        made.tune()
        files = ("axis.yaml", "axis.commissioning.yaml", f"{IDENTIFIED}/model.yaml", f"{TUNED}/axis.yaml")
        texts = [[_undated(chain.place / file) for chain in (made, typed)] for file in files]
        return ", ".join([*found, *(file for file, (one, other) in zip(files, texts, strict=True) if one != other)])


def _undated(path: Path) -> bytes:
    """A file without its dates, and without the hash over them."""
    text = path.read_bytes()
    undated = A_DATE.sub(b"DATE", text)
    return text if undated == text else re.sub(rb"(?m)^content_hash:.*$", b"", undated)


def _processor_s() -> float:
    """Processor time of this process and of all commands that it waited for."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


VERDICTS = (STABLE, CYCLE, UNSTABLE, HUNTING, TRIPPED, REFUSED, CRASHED)
BAD = (CYCLE, UNSTABLE, HUNTING, TRIPPED)
RANGE_VERDICTS = (STABLE, *BAD)


def table(found: list[Outcome]) -> list[str]:
    """Verdicts, creep, and every axis that is not stable."""
    passive = [one for one in found if one.passive]
    lines = [
        f"{len(found)} axes, numbers {found[0].number} to {found[-1].number}; {len(found) - len(passive)} that no "
        "controller can bring to rest are omitted below. One in "
        f"{ELASTIC_EVERY} has an elastic load of 20 to 400 Hz; some others have one of the registry's.",
        "",
        "| axes | stable and quiet | shakes: limit cycle | shakes at the current limit | hunts | trips | refused "
        f"| {CRASHED} | of the bad: warned beforehand; **without a word** "
        f"| creep over {MOST_CREEP_COUNTS:g} counts in 5 s | median, 95 % quantile of it |",
        "|---|" + "---|" * 10,
    ]
    for name, some in (
        ("all", passive),
        ("rigid", [one for one in passive if not one.elastic]),
        ("elastic", [one for one in passive if one.elastic]),
    ):
        counted = Counter(one.kind for one in some)
        bad = [one for one in some if one.kind in BAD]
        told = sum(bool(one.warned) for one in bad)
        known = np.array([one.creep_counts for one in some if math.isfinite(one.creep_counts)])
        beyond = f"{int(np.sum(known > MOST_CREEP_COUNTS))} of {known.size}"
        quantiles = ", ".join(f"{q:.1f}" for q in np.quantile(known, [0.5, 0.95])) if known.size else "–"
        cells = [*(str(counted[verdict]) for verdict in VERDICTS), f"{told}; **{len(bad) - told}**", beyond, quantiles]
        lines.append(f"| {name}: {len(some)} | " + " | ".join(cells) + " |")
    quiet = [one for one in passive if one.kind == STABLE]
    lines += ["", f"Of the stable ones {sum(bool(one.warned) for one in quiet)} were warned of as well.", ""]
    lines += range_table(passive)
    lines += _listed("Not stable", [one for one in passive if one.kind in BAD])
    lines += _reasons({one.number: one.refused for one in passive if one.refused})
    creeping = [one for one in quiet if one.creep_counts > MOST_CREEP_COUNTS]
    lines += _listed("Stable, but creeping", creeping)
    lines += _swinging(quiet)
    lines += ["Measured delay less the true one, ms (5 %, median, 95 % quantile): " + _delays(passive) + ".", ""]
    return lines


def range_table(passive: Sequence[Outcome]) -> list[str]:
    """Verdicts with the least and the largest inertia of the range that was declared."""
    chained = [one for one in passive if not one.refused]
    moved = [one for one in chained if one.light]
    lines = [
        "The same axes with a third and three times the model's inertia, tuned with `--inertia-range`: "
        f"{len(chained) - len(moved)} of {len(chained)} refused.",
        "",
        "| inertia | " + " | ".join(RANGE_VERDICTS) + " | of the bad: warned beforehand; **without a word** |",
        "|---|" + "---|" * (1 + len(RANGE_VERDICTS)),
    ]
    for name, which in (("a third", "light"), ("three times", "heavy")):
        counted = Counter(getattr(one, which) for one in moved)
        bad = [one for one in moved if getattr(one, which) != STABLE]
        told = sum(bool(one.warned or one.range_warned) for one in bad)
        cells = [*(str(counted[verdict]) for verdict in RANGE_VERDICTS), f"{told}; **{len(bad) - told}**"]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    silent = [
        f"{one.number} ({one.light}; {one.heavy})"
        for one in moved
        if {one.light, one.heavy} != {STABLE} and not (one.warned or one.range_warned)
    ]
    lines += ["", f"Without a word: {', '.join(silent) or 'none'}.", ""]
    return lines + _reasons({one.number: one.range_refused for one in chained if one.range_refused})


def _listed(title: str, some: Sequence[Outcome]) -> list[str]:
    """A line for each of these axes."""
    if not some:
        return [f"{title}: none.", ""]
    lines = [
        f"{title}:",
        "",
        "| axis | friction | effects | elastic load | verdict | margin | share at rest | creep, counts | told before |",
        "|---|" + "---|" * 8,
    ]
    for one in some:
        said = one.ran if one.ran and one.verdict == STABLE else one.kind
        lines.append(
            f"| {one.number} | {one.law} | {', '.join(one.effects)} | {one.elastic or '–'} | {said} "
            f"| {one.phase_deg:.0f} deg | {one.rest_share:.2f} | {one.creep_counts:.1f} "
            f"| {'; '.join(one.warned) or 'nothing'} |"
        )
    return [*lines, ""]


def _reasons(refused: Mapping[int, str]) -> list[str]:
    """Each reason for a refusal once, without its numbers, and the axes."""
    reasons: dict[str, list[int]] = {}
    for number, text in refused.items():
        reasons.setdefault(re.sub(r"[-+]?\d[\d.e+-]*", "#", text), []).append(number)
    lines = ["| refused because | axes |", "|---|---|"]
    rows = sorted(reasons.items(), key=lambda pair: -len(pair[1]))
    lines += [f"| {reason} | {len(numbers)}: {', '.join(map(str, numbers))} |" for reason, numbers in rows]
    return [*lines, ""] if refused else []


def read_rows(path: Path) -> list[Outcome]:
    """What `add_rows` wrote."""
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return [Outcome(**row | {name: tuple(row[name]) for name in ("effects", "warned", "range_warned")}) for row in rows]


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


def _swinging(quiet: Sequence[Outcome]) -> list[str]:
    """The stable axes that ring at rest."""
    ringing = [one for one in quiet if one.swing_counts > MOST_SWING_COUNTS]
    listed = ", ".join(f"{one.number} ({one.law}, {one.swing_counts:.0f})" for one in ringing) or "none"
    return [
        f"Stable ones that swing by more than {MOST_SWING_COUNTS:g} counts peak to peak in the last {SWING_S:g} s at "
        f"rest: {listed}.",
        "",
    ]


def compared_text(found: Sequence[Outcome]) -> str:
    """What the comparison of both ways to type the chain found."""
    known = [one for one in found if one.differing is not None]
    differing = [f"{one.number} ({one.differing})" for one in known if one.differing]
    text = (
        f"On axes {', '.join(str(one.number) for one in known)} the same chain in one process, by the functions of the "
    )
    text += "commands, wrote the same rows and files, dates aside"
    return f"{text}, but for {', '.join(differing)}." if differing else f"{text}."


def main(arguments: Sequence[str] | None = None) -> None:
    """Run everything and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--axes", type=int, help=f"how many (default {AXES}, typed {TYPED_AXES})")
    parser.add_argument("--first", type=int, default=FRESH, help="number of the first random axis")
    parser.add_argument("--typed", action="store_true", help="run the commands themselves, each in its process")
    parser.add_argument("--out", type=Path, help="the table (default results/chain.md, or chain_typed.md)")
    parser.add_argument("--rows", type=Path, help="save results here (JSON lines), and resume from it")
    options = parser.parse_args(arguments)
    axes = options.axes or (TYPED_AXES if options.typed else AXES)
    case = case_of(read_scenario(SCENARIO), 1)
    warm_up(case)
    found = read_rows(options.rows) if options.rows is not None and options.rows.is_file() else []
    known = {one.number for one in found}
    numbers = [n for n in range(options.first, options.first + axes) if n not in known]
    with progress_bar("axes") as progress:
        for part in (numbers[k : k + BATCH_AXES] for k in range(0, len(numbers), BATCH_AXES)):
            jobs = [
                Job(wide_axis(case.plant, n), case, options.typed, options.typed and n < options.first + COMPARED)
                for n in part
            ]
            new = over_cores(run_job, jobs)
            found += new
            if options.rows is not None:
                add_rows(options.rows, new)
            if progress is not None:
                progress((len(found) - len(known)) / len(numbers))
    found.sort(key=lambda one: one.number)
    commits = ", ".join(sorted({one.commit for one in found}))
    how = "by typed commands alone" if options.typed else "by the functions of the commands in one process"
    name = "chain_typed" if options.typed else "chain"
    lines = [
        f"# {name}",
        "",
        f"The chain on random axes, {how}: commission, excite (70 s of the paper's chirps of current), identify, tune,",
        "run. Where commissioning finds no single rigid inertia, diagnose comes before tune, as tune advises.",
        "Only the torque constant is given, 5 % wrong.",
        "",
        *table(found),
        *([compared_text(found), ""] if options.typed else []),
        f"{made_by('chain.py', commits)} {np.median([one.cpu_s for one in found]):.0f} s of processor time an axis.",
    ]
    (options.out or RESULTS / f"{name}.md").write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
