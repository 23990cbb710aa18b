"""Are p-values and intervals what they say? Drives without effects, and drives with one whose size is known."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from blind_drives.draw import base_plant, chirp_current_a, gains_of, plant_draws, with_limits
from blind_drives.profiles import RATE_HZ, Profile, profiles
from blind_drives.run import record_of
from blind_drives.score import wilson
from blind_drives.simulate import simulate
from common import RESULTS, Report, finish, main, parser, shown
from engine import Call, accepted_of, diagnosed, in_parallel, write_answer

from fffo_drive.drive.simulated.parameters import EffectConfig, PlantConfig
from fffo_drive.identification.dataset import Record
from fffo_drive.identification.facts import DriveFacts
from fffo_drive.units import NORMAL_95

NAME = "calibration"
PURPOSE = (
    "Drives of the blind generator without effects, in short runs: how often the smallest p of the first round, over "
    "the whole search, is below a level. Drives with one planted effect: how often the 95 % interval of a parameter "
    "contains the true value."
)
DRIVES, SAMPLE = 300, 2
LEVELS = (0.001, 0.01, 0.05, 0.1, 0.2, 0.5)
FIRST_SEED = 51_000  # far from the seeds of the blind sets
# what the runs are cut to, s from their beginnings: both begin near standstill
TRACK_S, RECIPE_S = (10.0, 45.0), (0.0, 40.0)
COVERED = 0.95


class Planted(NamedTuple):
    """An effect of a size that is drawn."""

    name: str
    key: str  # of the size in the plant
    range: tuple[float, float]
    said_as: str  # by the report; WAVE: the length of cosine and sine


WAVE = "wave"
PLANTED = (  # by turns
    Planted("torque_offset", "torque_nm", (0.003, 0.01), "torque_nm"),
    Planted("asymmetric_coulomb", "share", (0.1, 0.3), "share"),
    Planted("quadratic_drag", "drag_nm_per_rps2", (0.0001, 0.0003), "drag_nm_per_rps2"),
    Planted("cogging", "amplitude_nm", (0.004, 0.01), WAVE),
)
BASE = {"inertia_kg_m2": "inertia", "coulomb_nm": "Coulomb", "viscous_nm_per_rps": "viscous"}


def drive_of(seed: int, effects: tuple[EffectConfig, ...] = ()) -> tuple[list[Record], DriveFacts, PlantConfig]:
    """The two shortened runs of a drive on the single surface, its facts, and what is true."""
    plant = replace(with_limits(base_plant(plant_draws(seed), seed), []), effects=effects)
    gains = gains_of(plant)
    asked = {profile.name: profile for profile in profiles(seed, chirp_current_a(plant))}
    facts = DriveFacts.model_validate({
        "torque_constant_nm_per_a": plant.torque_constant_nm_per_a, "rated_current_a": plant.rated_current_a,
        "gear_ratio": int(plant.gear_ratio), "resolver_bits": plant.resolver.bits, "sample_rate_hz": RATE_HZ,
    })  # fmt: skip
    cut = [_cut(asked["track"], TRACK_S), _cut(asked["recipe"], RECIPE_S)]
    records = [record_of(simulate(plant, gains, one, 4 * seed + k), facts) for k, one in enumerate(cut)]
    return records, facts, plant


def _cut(profile: Profile, part_s: tuple[float, float]) -> Profile:
    return profile._replace(values=profile.values[int(part_s[0] * RATE_HZ) : int(part_s[1] * RATE_HZ)])


def quiet(seed: int, answer: Path) -> None:
    """Diagnose a drive without effects; the smallest p of the first round and the number of findings, to a file."""
    if answer.exists():
        return
    records, facts, plant = drive_of(seed)
    said = diagnosed(records, [], facts)
    write_answer(answer, {"first_p": said["first_p"], "accepted": len(accepted_of(said)), "z": _base_z(said, plant)})


def planted(seed: int, answer: Path) -> None:
    """Diagnose a drive with one effect; how many standard deviations its size and the base are off, to a file."""
    if answer.exists():
        return
    effect = planted_effect(seed)
    records, facts, plant = drive_of(seed, (effect,))
    said = diagnosed(records, [], facts)
    found = next((f for f in accepted_of(said) if f["name"] == effect.name), None)
    asked = PLANTED[seed % len(PLANTED)]
    size = None if found is None else size_z(found, asked.said_as, effect.parameters[asked.key])
    write_answer(answer, {"effect": effect.name, "size_z": size, "z": _base_z(said, plant)})


def planted_effect(seed: int) -> EffectConfig:
    """The effect of a drive of this seed."""
    asked, draws = PLANTED[seed % len(PLANTED)], np.random.default_rng((seed, 9))
    parameters = {asked.key: float(draws.uniform(*asked.range))}
    if asked.said_as == WAVE:
        parameters |= {"order": float(draws.integers(2, 13)), "phase_rev": float(draws.uniform())}
    return EffectConfig(asked.name, parameters)


def size_z(finding: dict[str, Any], said_as: str, true: float) -> float | None:
    """Error of a size over its standard deviation; that of a WAVE is the length of its cosine and sine. Signs are left
    out: a plant's torque is a load in a model."""
    values, sd = finding["parameters"], finding["sd"]
    if said_as != WAVE:
        return None if not sd.get(said_as) else float((abs(values[said_as]) - true) / sd[said_as])
    cos, sin = values["cos_nm"], values["sin_nm"]
    if isinstance(cos, dict) or not sd.get("cos_nm") or not sd.get("sin_nm"):
        return None  # a phase of its own a run: several sizes
    size = float(np.hypot(cos, sin))
    return float((size - true) / (np.hypot(cos * sd["cos_nm"], sin * sd["sin_nm"]) / size))


def _base_z(said: dict[str, Any], plant: PlantConfig) -> dict[str, float]:
    single = plant.friction.single
    true = {
        "inertia_kg_m2": plant.inertia_kg_m2, "coulomb_nm": single.coulomb_nm,
        "viscous_nm_per_rps": single.viscous_nm_per_rps,
    }  # fmt: skip
    fitted = {name: said["fitted"].get(name, [0.0, None]) for name in true}
    return {name: (fitted[name][0] - true[name]) / fitted[name][1] for name in true if fitted[name][1]}


def run() -> int:
    """Diagnose, count, draw."""
    made = parser(NAME, PURPOSE, DRIVES, SAMPLE)
    made.add_argument("--answers", type=Path, help="a folder that keeps the answers, for interrupted runs")
    made.add_argument("--jobs", type=int, default=2, help="processes")
    options = made.parse_args()
    number = options.passes or (SAMPLE if options.sample else DRIVES)
    seeds = range(FIRST_SEED, FIRST_SEED + number)
    with tempfile.TemporaryDirectory() as folder, shown("calibration") as progress:
        answers = options.answers or Path(folder)
        calls: list[Call] = [(quiet, (seed, answers / "quiet" / f"{seed}.json")) for seed in seeds]
        calls += [(planted, (seed, answers / "planted" / f"{seed}.json")) for seed in seeds]
        in_parallel(calls, options.jobs, progress)
        without, with_one = (
            [json.loads((answers / kind / f"{seed}.json").read_text()) for seed in seeds]
            for kind in ("quiet", "planted")
        )
    report = calibration_report(without, with_one)
    if not options.sample:
        draw(without, with_one, RESULTS / f"{NAME}.svg")
        report.tables.append(f"![p-values, and errors over their standard deviations]({NAME}.svg)")
    return finish(report, options)


def calibration_report(without: Sequence[dict[str, Any]], with_one: Sequence[dict[str, Any]]) -> Report:
    """Shares below each level, findings without an effect, and coverage."""
    report = Report(NAME, PURPOSE)
    p = np.array([one["first_p"] for one in without if one["first_p"] is not None])
    for level in LEVELS if p.size else ():
        below = wilson(int((p <= level).sum()), p.size)
        # only a larger share than the level is a fault: p counts candidates as if they were independent
        report.bounded(f"p below {level:g} without an effect", str(below), below.low <= level, f"<= {100 * level:g} %")
        report.facts[f"p <= {level:g}"] = below.value
    if not p.size:
        report.notes.append("**This version of the search does not report the p of its first round.**")
    false = wilson(sum(one["accepted"] > 0 for one in without), len(without))
    report.bounded("drives without an effect with a finding", str(false))
    report.facts["false"] = false.found
    for name, errors in standardised(without, with_one).items():
        inside = wilson(int((np.abs(errors) <= NORMAL_95).sum()), errors.size)
        report.bounded(
            f"95 % interval contains the true value: {name}",
            str(inside),
            inside.high >= COVERED,
            f"{100 * COVERED:g} %",
        )
        report.facts[f"coverage: {name}"] = inside.value
    named = wilson(sum(one["size_z"] is not None for one in with_one), len(with_one))
    report.bounded("planted effects named, with an interval", str(named))
    report.facts["drives"] = len(without)
    report.notes += [
        f"{len(without)} drives without an effect and as many with one, on the paper's single surface: "
        f"{TRACK_S[1] - TRACK_S[0]:g} s of `track` and {RECIPE_S[1] - RECIPE_S[0]:g} s of `recipe`, nothing held out.",
        "Coverage is over named effects only: a missed effect has no interval.",
    ]
    return report


def standardised(
    without: Sequence[dict[str, Any]], with_one: Sequence[dict[str, Any]]
) -> dict[str, np.ndarray[Any, Any]]:
    """Errors over their standard deviations, by what they are of; (n,) each."""
    found: dict[str, list[float]] = {}
    for kind, drives in (("no effect", without), ("one effect", with_one)):
        for one in drives:
            for name, z in one["z"].items():
                found.setdefault(f"{BASE[name]}, {kind}", []).append(z)
    for one in with_one:
        if one["size_z"] is not None:
            found.setdefault(one["effect"], []).append(one["size_z"])
    return {name: np.array(values) for name, values in found.items()}


def draw(without: Sequence[dict[str, Any]], with_one: Sequence[dict[str, Any]], path: Path) -> None:
    """Left: share of drives whose p lies below a level, beside what it should be. Right: errors over their sd."""
    import matplotlib as mpl

    mpl.use("svg")
    mpl.rcParams |= {"svg.hashsalt": NAME, "svg.fonttype": "none"}  # the same picture, byte for byte, and small
    from matplotlib import pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.6), layout="constrained")
    p = np.sort([one["first_p"] for one in without if one["first_p"] is not None])
    levels = np.geomspace(1e-4, 1.0, 100)
    left.loglog(levels, levels, "k--", lw=1, label="upper limit")
    if p.size:
        left.step(np.clip(p, levels[0], None), np.arange(1, p.size + 1) / p.size, where="post", label="measured")
    left.set(xlabel="smallest p of the first round", ylabel="share of drives without an effect", ylim=(1e-3, 1.2))
    left.legend()
    errors = standardised(without, with_one)
    right.boxplot(list(errors.values()), whis=(2.5, 97.5), orientation="horizontal", showfliers=False)
    right.set_yticks(range(1, len(errors) + 1), list(errors))
    for edge in (-NORMAL_95, NORMAL_95):
        right.axvline(edge, color="k", ls="--", lw=1)
    right.set(xlabel="error / standard deviation (whiskers: 95 %)", xlim=(-8.0, 8.0))
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


if __name__ == "__main__":
    main(run)
