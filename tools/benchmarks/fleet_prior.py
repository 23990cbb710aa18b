"""Seconds of motion with the population as a prior, beside a full recipe; and drives of another population.

  tools/benchmarks/fleet_prior --lives DIR [--drives N M]

N drives without wear make the population and M others are measured, on the simulated drive's plant. Their records are
kept in DIR, and missing ones are made. Each measured drive moves for five seconds on the day of one of its runs
(configs/profiles/short.yaml); that run itself, of random moves, is the comparison. `--only-kept` uses the
drives whose records exist.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import yaml
from common import RESULTS, ROOT, made_by, progress_bar
from lives_plant import NONE, SPEED_RPS, Life, life_runs, lives, recorded
from lives_records import THERMOMETER_K, RealLife, make_life, read_life, row_of, without_temperature

from fffo_drive.config.scenario import case_of, read_scenario
from fffo_drive.control.reference import MODE_VELOCITY, Profile, piecewise_linear
from fffo_drive.evaluation.campaign import Candidate, Case, warm_up
from fffo_drive.fleet.channels import MEAN_DEGC, STEP_K, inverse_total, learn, stacked
from fffo_drive.fleet.prior import Population, Posterior, RunEstimate, population_of, posterior
from fffo_drive.fleet.regress import PARAMETERS

Floats = npt.NDArray[np.float64]

SCENARIO = ROOT / "configs" / "scenarios" / "paper.yaml"
SHORT = ROOT / "configs" / "profiles" / "short.yaml"  # of nine staircases the one with the least bias for TEACHING
TEACHING, MEASURED, OTHER = 51, 52, 53  # seeds
RUNS = 34
TEST_RUN = 17  # whose day the seconds of motion are on
FULL_RUNS = 8  # of the others, those nearest in temperature: a full recipe, about a minute of motion
MORE_FRICTION = (0.15, 0.3, 0.45, 0.6, 0.8, 1.0)  # of drives of another population
OTHERS = 60  # drives of each
CONFIDENCE, NORMAL_95 = 0.95, 1.96
NOT_JUDGED = "inertia_nm_s2_per_rev"  # each run has its own payload


class Rows(NamedTuple):
    """What a short run gives."""

    theta: Floats
    information: Floats
    degc: float

    def estimate(self, degc: float | None) -> RunEstimate:
        """As a run of a drive, at a temperature that was logged or not."""
        return RunEstimate(PARAMETERS, self.theta, self.information, degc)


class Judged(NamedTuple):
    """Errors over the sizes of parameters (d, p), whether intervals cover (d, p), drives wrongly flagged."""

    error: Floats
    covered: Floats
    flagged: int


def staircase(period_s: float) -> Profile:
    """The profile that is shipped for this, up to the highest speed of these drives."""
    points = np.array(yaml.safe_load(SHORT.read_text(encoding="utf-8"))["profile"]["points"])
    scale = SPEED_RPS[1] / points[:, 1].max()
    return piecewise_linear("staircase", MODE_VELOCITY, period_s, points[:, 0], scale * points[:, 1])


def short_run(case: Case, candidate: Candidate, life: Life, seed: int, path: Path) -> Rows:
    """The staircase of a drive on the day of TEST_RUN; kept at `path`."""
    if not path.exists():
        period_s = case.session.loop.period_ns * 1e-9
        day = life_runs(life, case.plant, period_s, seed)[TEST_RUN]
        row = row_of(recorded(case, candidate, day._replace(profile=staircase(period_s)), str(life.number)))
        degc = day.temperature_degc + THERMOMETER_K * np.random.default_rng([seed, life.number, 8]).standard_normal()
        np.savez(path, theta=row["theta"], info=row["info"], degc=degc)
    with np.load(path) as file:
        return Rows(file["theta"], file["info"], float(file["degc"]))


def kept_lives(directory: Path, drives: int, seed: int, case: Case, candidate: Candidate, only: bool) -> list[RealLife]:
    """Lives on the plant; what DIR lacks is simulated, or left out with `only`."""
    place = directory / f"rec_{seed}"
    place.mkdir(parents=True, exist_ok=True)
    found = []
    with progress_bar(f"lives of seed {seed}") as progress:
        for life in lives(drives, RUNS, seed, (NONE,)):
            path = place / f"{life.number}.npz"
            if not path.exists():
                if only:
                    continue
                make_life(case, candidate, life, seed, path)
            one = read_life(life, path)
            if one.history.time_s.size == RUNS:  # none tripped
                found.append(one)
            if progress is not None:
                progress((life.number + 1) / drives)
    return found


def level_at(theta: Floats, steps: Floats, inverse: Floats, slope: Floats, slope_sd: Floats) -> tuple[Floats, Floats]:
    """Parameters (p,) of a drive at step 0 by all of these runs and its slope with temperature, and their sds."""
    p = theta.shape[1]
    design = np.column_stack([np.ones(steps.size), steps])
    normal = np.einsum("na,nb,nij->aibj", design, design, inverse).reshape(2 * p, 2 * p)
    right = np.einsum("na,nij,nj->ai", design, inverse, theta).reshape(2 * p)
    normal[np.arange(p, 2 * p), np.arange(p, 2 * p)] += slope_sd**-2.0
    right[p:] += slope / slope_sd**2
    size = np.sqrt(np.diag(normal))
    variance = np.diag(np.linalg.inv(normal / np.outer(size, size))) / size**2
    level = np.linalg.solve(normal / np.outer(size, size), right / size) / size
    return np.asarray(level[:p]), np.sqrt(variance[:p])


def judged(found: Sequence[Posterior], truth: Floats, truth_sd: Floats, scale: Floats) -> Judged:
    """Posteriors against truths (d, p), which are known to an sd (d, p) themselves: both are within the interval."""
    half = np.array([0.5 * np.diff(one.interval(CONFIDENCE), axis=1)[:, 0] for one in found])
    away = np.array([one.theta for one in found]) - truth
    covered = np.abs(away) <= np.hypot(half, NORMAL_95 * truth_sd)
    error = away / scale
    return Judged(error, covered.astype(np.float64), sum(one.other_population for one in found))


def rms(values: Floats) -> Floats:
    """Of each parameter. (p,)"""
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def other_drives(directory: Path, case: Case, candidate: Candidate, population: Population) -> list[tuple[int, int]]:
    """How many drives of each other population are flagged, with and without the temperature of their run."""
    found = []
    for number, more in enumerate(MORE_FRICTION):
        flagged = [0, 0]
        for drive in range(OTHERS):
            life = Life(1000 * number + drive, RUNS, NONE, 0, 0, more_friction=more)
            run = short_run(case, candidate, life, OTHER, directory / f"other_{life.number}.npz")
            for place, degc in enumerate((run.degc, None)):
                flagged[place] += posterior(population, [run.estimate(degc)]).other_population
        found.append((flagged[0], flagged[1]))
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Run everything and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lives", type=Path, required=True, metavar="DIR", help="where records of lives are kept")
    parser.add_argument("--drives", type=int, nargs=2, default=(40, 200), metavar="N", help="that teach; measured")
    parser.add_argument("--only-kept", action="store_true", help="simulate no further life")
    parser.add_argument("--out", type=Path, default=RESULTS / "fleet_prior.md")
    options = parser.parse_args(arguments)
    case = case_of(read_scenario(SCENARIO), 1)
    candidate = next(one for one in case.candidates if one.name == "pi+fffo")
    warm_up(case)
    teaching = kept_lives(options.lives, options.drives[0], TEACHING, case, candidate, options.only_kept)
    measured = kept_lives(options.lives, options.drives[1], MEASURED, case, candidate, options.only_kept)
    shorts = options.lives / "short"
    shorts.mkdir(exist_ok=True)
    staircases = [short_run(case, candidate, o.life, MEASURED, shorts / f"{o.life.number}.npz") for o in measured]
    taught = {str(one.life.number): one.history for one in teaching}
    population = population_of(taught)
    unlogged = population_of({name: without_temperature(one) for name, one in taught.items()})
    names = [name for name in population.names if name != NOT_JUDGED]
    place = [population.names.index(name) for name in names]
    scale = np.abs(population.mean[place])
    scale[names.index("offset_nm")] = scale[names.index("coulomb_nm")]
    scale[names.index("viscous_excess_nm_per_rps")] = scale[names.index("viscous_nm_per_rps")]
    columns = [PARAMETERS.index(name) for name in population.names]

    stack = stacked({str(one.life.number): one.history for one in measured})
    fleet = learn(stack)
    truth, truth_sd, full = np.empty((3, len(measured), len(names)))
    for number, one in enumerate(measured):
        runs, size = stack.of(number), stack.scales[number]
        theta, steps = stack.theta[runs], (one.history.temperature_degc - MEAN_DEGC) / STEP_K
        own = [k for k in range(RUNS) if k != TEST_RUN]
        near = sorted(own, key=lambda k: abs(steps[k] - steps[TEST_RUN]))[:FULL_RUNS]
        rest = [k for k in own if k not in near]
        inverse = inverse_total(stack.information[runs], fleet.covariance)
        at = steps - steps[TEST_RUN]
        level, level_sd = level_at(theta[rest], at[rest], inverse[rest], fleet.slope, fleet.slope_sd)
        truth[number], truth_sd[number] = (level * size)[place], (level_sd * size)[place]
        weighted = stack.information[runs][near]
        moment = np.einsum("nij,nj->i", weighted, theta[near])
        full[number] = (np.linalg.solve(weighted.sum(axis=0), moment) * size)[place]
    full_error = rms((full - truth) / scale)

    randoms = [
        Rows(h.theta[TEST_RUN], h.information[TEST_RUN], float(h.temperature_degc[TEST_RUN]))
        for h in (one.history for one in measured)
    ]
    rows, coverage, wrongly = [], [], []
    for kind, runs in (("staircase of 5 s", staircases), ("random moves, 5 to 10 s", randoms)):
        alone = np.array([run.theta[columns][place] for run in runs])
        rows.append([kind, "none", *(f"{r:.2f}" for r in rms((alone - truth) / scale) / full_error)])
        for prior, logged, text in (
            (population, True, "population, temperature logged"),
            (population, False, "population, temperature of the run unknown"),
            (unlogged, False, "population without temperatures"),
        ):
            every = [posterior(prior, [r.estimate(r.degc if logged else None)]) for r in runs]
            kept = [one._replace(theta=one.theta[place], covariance=one.covariance[np.ix_(place, place)])
                    for one in every]  # fmt: skip
            found = judged(kept, truth, truth_sd, scale)
            rows.append([kind, text, *(f"{r:.2f}" for r in rms(found.error) / full_error)])
            share = found.covered.mean(axis=0)
            coverage.append([kind, text, *(f"{100 * one:.1f}" for one in share), f"{100 * found.covered.mean():.1f}"])
            wrongly.append(f"{kind}, {text}: {found.flagged} of {len(measured)}")
    others = other_drives(shorts, case, candidate, population)
    spread = np.sqrt(np.diag(population.covariance))[place] / scale
    header = ["motion", "prior", *names]
    lines = [
        "# fleet_prior", "",
        f"{len(teaching)} drives make the population (seed {TEACHING}, {RUNS} runs each), {len(measured)} others are "
        f"measured (seed {MEASURED}). Full recipe: the {FULL_RUNS} runs of the drive nearest in temperature, 60 s in "
        f"the mean. Truth: its other {RUNS - FULL_RUNS - 1} runs, with a slope for temperature. Inertia is omitted: "
        "each run has its own payload.", "",
        "## Error over that of the full recipe (rms over drives; target: at most 1.1)", "",
        *table([header, *rows]), "",
        "The full recipe's own error, in per cent (of viscous or Coulomb friction for the last two): "
        f"{percent(names, full_error)}. Spread between drives: {percent(names, spread)}. The truth is known to "
        f"{percent(names, rms(truth_sd / scale))}; the intervals below include this.", "",
        "## Coverage of 95 % intervals, in per cent (target: 93 to 97)", "",
        *table([[*header, "all"], *coverage]), "",
        "## Drives of another population, reported at p 0.01", "",
        *table([
            ["friction", "inertia", "reported, temperature logged", "temperature unknown"],
            *([f"+{100 * more:.0f} %", f"+{40 * more:.0f} %", f"{100 * a / OTHERS:.0f} % of {OTHERS}",
               f"{100 * b / OTHERS:.0f} %"] for more, (a, b) in zip(MORE_FRICTION, others, strict=True)),
        ]), "",
        "By the staircase of 5 s. Reported among drives of the population itself: " + "; ".join(wrongly) + ".", "",
        made_by("fleet_prior"),
    ]  # fmt: skip
    options.out.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))


def percent(names: Sequence[str], shares: Floats) -> str:
    """Shares with their names."""
    return ", ".join(f"{name} {100 * share:.1f}" for name, share in zip(names, shares, strict=True))


def table(rows: Sequence[Sequence[str]]) -> list[str]:
    """Markdown; the first row is the heading."""
    cells = [rows[0], ["---"] * len(rows[0]), *rows[1:]]
    return ["| " + " | ".join(row) + " |" for row in cells]


if __name__ == "__main__":
    main()
