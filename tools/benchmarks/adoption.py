"""What adopting an effect gives a user: each compensable effect, met by an axis that the commands have tuned.

The files are those that the commands write (chain_files.py), run as they are: power-on to `tune` for the axis without
the effect, then `close-the-loop` on the tuned file once the axis has the effect. With --rows each effect is saved when
it is done, and the same command resumes after an interruption.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
import yaml
from chain import REFUSALS
from chain_files import Chain
from common import Report, finish, main, parser, passes_of, shown

from fffo_drive.config.axis import build_profile, model_of, read_axis
from fffo_drive.drive.simulated.parameters import EffectConfig, PlantConfig, paper_plant
from fffo_drive.evaluation.metrics import profile_rows, run_metrics
from fffo_drive.recording.reader import read_run

NAME = "adoption"
PURPOSE = (
    "Each compensable effect, with 30 % of the Coulomb friction. The commands tune an axis that does not have it, from "
    "power-on: commission, run, identify, tune. Then the axis has the effect, and runs the paper's reference with that "
    "file (`with it`), with the file of a new `identify` and `tune` (`identified`), and with the file of "
    "`close-the-loop` (`adopted`; where it adopts nothing, the file stays). Nothing but the effect's own presence in "
    "the simulated drive is set by this program. Excess: squared velocity error of the shaft above that of the axis "
    "without the effect."
)
LEAST_FALL = 0.70
MOST_WORSE_PERCENT = 2.0
SIGNIFICANT = 2.0  # standard errors of the excess over the seeds
LEAST_GIVEN = 0.01  # of the Coulomb friction: less torque counts as none
GEAR_RATIO = 160.0

TRIALS: dict[str, Mapping[str, float]] = {  # effects of the plant
    "torque_offset": {"torque_nm": 0.0075},
    "asymmetric_coulomb": {"share": 0.3},
    "asymmetric_viscous": {"share": 0.36},
    "stribeck_shape": {"rise_share": 0.18, "velocity_share": 1.0},
    "presliding_shape": {"stiffness_share": -0.7},
    "frictional_lag": {"length_share": 3.0},
    "dwell_stiction": {"rise_share": 0.3},
    "load_dependent_friction": {"share": 0.05},
    "position_dependent_friction": {"wave_share": 0.3, "period_rev": 8.0},
    "friction_ripple": {"share": 0.3, "order": 2.0},
    "coulomb_drift": {"share": 0.3, "time_constant_s": 15.0},
    "viscous_drift": {"share": 0.36, "time_constant_s": 15.0},
    "quadratic_drag": {"drag_nm_per_rps2": 1.5e-4},
    "cogging": {"amplitude_nm": 0.0075, "order": 6.0},
    "torque_ripple": {"share": 0.05, "order": 6.0},
    "unbalance": {"amplitude_nm": 0.0075},
    "torque_saturation": {"share": 1.0},
    "dead_zone": {"width_a": 0.05},
    "current_lag": {"time_constant_s": 0.002},
}
SAMPLE = ("cogging",)
# what a refit leaves of these is no torque that could be given: not held against the law
LEFT_TO_THE_LOOP = {
    "current_lag": "what a refit leaves of `current_lag` is no torque: with the refitted Td the feed-forward is on "
    "time, but the lag remains in the feedback loop",
}
NOT_COMPENSATED = {
    "delay": "no torque: the refit of Td includes it, and the reference is read ahead by it",
    "elasticity": "a torque on the load side, whose angle is not measured",
    "backlash": "as elasticity; also, the position of the load in the gap is unknown",
    "voltage_limit": "no torque is left: an increase of the command has no effect",
    "resolver_error": "no torque: the measured angle is wrong, and compensating it would move the shaft",
    "periodic_disturbance": "periodic in time, with a different phase in every run",
    "unknown:frequency": "not a function of what is known in advance; a curve over any other axis is compensated where "
    "it was seen",
}
KINDS = {"five surfaces": PlantConfig(), "single surface": paper_plant()}


class Outcome(NamedTuple):
    """One effect on one kind of friction; ISE of the shaft's velocity by seed."""

    kind: str
    name: str
    duration_s: float  # of the reference
    clean: list[float]  # axis without the effect, the file of its chain
    unaware: list[float]  # axis with the effect, the same file
    identified: list[float]  # ... the file of a new `identify` and `tune`
    adopted: list[float]  # ... the file of `close-the-loop`
    given: float  # rms of the torque that is given for effects then, over the Coulomb friction
    found: list[str]  # by `close-the-loop`
    said: list[str]  # why a command wrote no file, so that the one before stays

    @property
    def significant(self) -> bool:
        """The effect makes an excess, by its spread over the seeds."""
        return _is_excess(self.unaware, self.clean)

    @property
    def left(self) -> bool:
        """`identify` leaves something to adopt: an excess, and a torque for it."""
        return _is_excess(self.identified, self.clean) and self.given > LEAST_GIVEN

    @property
    def fall(self) -> float:
        """Share of the excess that the adoption takes away."""
        return _fall(self.unaware, self.adopted, self.clean)

    @property
    def further_fall(self) -> float:
        """Share of the excess that `identify` leaves which the adoption takes away."""
        return _fall(self.identified, self.adopted, self.clean)

    @property
    def worse_percent(self) -> float:
        """Change of the squared error by the adoption, mean over paired seeds."""
        return 100.0 * float(np.mean(np.array(self.adopted) / self.unaware) - 1.0)


def _is_excess(error: Sequence[float], clean: Sequence[float]) -> bool:
    excess = np.subtract(error, clean)
    spread = float(np.std(excess, ddof=1)) if excess.size > 1 else 0.0
    mean = float(np.mean(excess))
    return bool(mean > SIGNIFICANT * spread / np.sqrt(excess.size) and mean > 0.0)


def _fall(before: Sequence[float], after: Sequence[float], clean: Sequence[float]) -> float:
    return 1.0 - float(np.mean(np.subtract(after, clean))) / float(np.mean(np.subtract(before, clean)))


class Reference(NamedTuple):
    """The paper's reference."""

    seeds: range
    duration_s: float


class Driven(NamedTuple):
    """One axis file over all seeds."""

    ises: list[float]  # of the shaft's velocity
    given: float  # rms of the torque for effects, over the Coulomb friction


def driven(chain: Chain, plant: PlantConfig, axis_path: Path, reference: Reference) -> Driven:
    """`run AXIS --profile FILE --out RUN` with the reference of each seed; the axis' noise has the same seed."""
    out, profile_path = chain.place / "seed.mcap", chain.place / "seed.yaml"
    axis = read_axis(axis_path)
    section = axis.profile.model_copy(update={"duration_s": reference.duration_s})
    samples = build_profile(section, axis.loop.period_s).values.size
    ises, given_nm = [], []
    for seed in reference.seeds:
        chain.connect(replace(plant, seed=seed))
        profile_path.write_text(yaml.safe_dump({"profile": section.model_dump() | {"seed": seed}}), encoding="utf-8")
        out.unlink(missing_ok=True)
        chain.typed("run", axis_path, "--profile", profile_path, "--out", out)
        rows = read_run(out).rows
        ises.append(run_metrics(rows, axis.loop.period_s, samples, "true_velocity_rps").ise)
        given_nm.append(float(np.sqrt(np.mean(profile_rows(rows, samples)["effects_nm"] ** 2))))
    chain.connect(plant)
    return Driven(ises, float(np.mean(given_nm)) / model_of(axis_path, axis).friction.coulomb_nm.value)


def try_effect(chain: Chain, kind: str, name: str, clean: list[float], reference: Reference) -> Outcome:
    """The axis of a chain has the effect from now on: identify and tune anew; close the loop; run."""
    plant = with_effect(KINDS[kind], name)
    chain.connect(plant)
    place, said = chain.place / name, []
    adopted = anew = chain.tuned
    found: list[str] = []
    try:
        closed = chain.typed("close-the-loop", chain.tuned, "--out", place, "--json")
        found = closed["effects"]
        adopted = place / "axis.yaml" if closed["adopted"] else chain.tuned
    except REFUSALS as error:
        said.append(str(error))
    try:
        model = place / "model"
        chain.typed("identify", place / "identify.mcap", place / "recipe.mcap", "--out", model)
        chain.typed("tune", model / "model.yaml", "--axis", chain.axis, "--out", place / "tuned")
        anew = place / "tuned" / chain.axis.name
    except REFUSALS as error:
        said.append(str(error))
    unaware, identified, last = (driven(chain, plant, file, reference) for file in (chain.tuned, anew, adopted))
    errors = clean, unaware.ises, identified.ises, last.ises
    return Outcome(kind, name, reference.duration_s, *errors, last.given, found, said)


def with_effect(plant: PlantConfig, name: str) -> PlantConfig:
    """The plant with the effect of a trial. Raises PlantConfigError."""
    return replace(plant, effects=(EffectConfig(name, dict(TRIALS[name])),)).validate()


def outcomes(kind: str, names: Sequence[str], reference: Reference) -> Iterator[Outcome]:
    """Each effect on one kind of friction, one after another."""
    plant = KINDS[kind]
    with TemporaryDirectory(prefix="chain_") as place:
        chain = Chain(Path(place))
        chain.type(plant, plant.torque_constant_nm_per_a)
        clean = driven(chain, plant, chain.tuned, reference).ises
        for name in names:
            yield try_effect(chain, kind, name, clean, reference)


def read_rows(path: Path | None) -> list[Outcome]:
    """What `run` saved."""
    lines = path.read_text(encoding="utf-8").splitlines() if path is not None and path.is_file() else []
    return [Outcome(**json.loads(line)) for line in lines]


def table_of(report: Report, kind: str, found: Sequence[Outcome]) -> None:
    """The table of one kind of friction."""
    rows = []
    for o in found:
        fall = f"{100.0 * o.fall:.1f} %" if o.significant else "no excess"
        further = f"{100.0 * o.further_fall:.1f} %" if o.left else "nothing left"
        further += " (below)" if o.left and o.name in LEFT_TO_THE_LOOP else ""
        cells = (f"{np.mean(x):.6f}" for x in (o.clean, o.unaware, o.identified, o.adopted))
        change, given = f"{o.worse_percent:+.1f} %", f"{100.0 * o.given:.1f} %"
        rows.append((f"`{o.name}`", ", ".join(o.found) or "-", *cells, given, fall, further, change,
                     "; ".join(o.said) or "-"))  # fmt: skip
    header = (
        "found", "ISE without it", "with it", "identified", "adopted", "torque for effects, of Fc", "excess falls by",
        "of what `identify` leaves", "adopted/with it", "refused",
    )  # fmt: skip
    report.table((f"{kind}: effect", *header), rows)
    for what, falls in (
        ("fall of a significant excess", [o.fall for o in found if o.significant]),
        (
            "fall of what `identify` leaves of it",
            [o.further_fall for o in found if o.left and o.name not in LEFT_TO_THE_LOOP],
        ),
    ):
        if falls:
            report.figure(f"{kind}: smallest {what}, missing to 1", 1.0 - min(falls), "", 1.0 - LEAST_FALL)
    report.figure(
        f"{kind}: largest rise of the squared error by an adoption", max(o.worse_percent for o in found), "%",
        MOST_WORSE_PERCENT,
    )  # fmt: skip


def run() -> int:
    """The command."""
    options = parser(NAME, PURPOSE, 4, 2)
    options.add_argument("--only", action="append", choices=TRIALS, help="an effect (may be given more than once)")
    options.add_argument("--kind", action="append", choices=KINDS, help="a kind of friction (more than once: several)")
    options.add_argument("--duration-s", type=float, default=60.0, help="of the reference")
    options.add_argument("--rows", type=Path, metavar="FILE", help="save results here (JSON lines), and resume from it")
    chosen = options.parse_args()
    names = chosen.only or (SAMPLE if chosen.sample else list(TRIALS))
    reference = Reference(range(1, passes_of(chosen) + 1), 20.0 if chosen.sample else chosen.duration_s)
    kinds = chosen.kind or list(KINDS)[: 1 if chosen.sample else None]
    for name in TRIALS:
        with_effect(PlantConfig(), name)  # refused now, and not after an hour
    done = {(o.kind, o.name): o for o in read_rows(chosen.rows) if o.duration_s == reference.duration_s
            and len(o.clean) == len(reference.seeds)}  # fmt: skip
    report = Report(NAME, PURPOSE)
    with shown(NAME) as progress:
        for kind in kinds:
            missing = [name for name in names if (kind, name) not in done]
            for o in outcomes(kind, missing, reference) if missing else ():
                done[kind, o.name] = o
                if chosen.rows is not None:
                    with chosen.rows.open("a", encoding="utf-8") as file:
                        file.write(json.dumps(o._asdict()) + "\n")
                if progress is not None:
                    progress(len(done) / (len(kinds) * len(names)))
                else:
                    print(f"{kind}: {o.name}: {o}", file=sys.stderr)
            found = [done[kind, name] for name in names]
            for o in found:
                report.facts[f"{kind}: {o.name}"] = o._asdict() | {
                    key: getattr(o, key) for key in ("significant", "left", "fall", "further_fall", "worse_percent")
                }
            table_of(report, kind, found)
    report.table(("not compensated", "why"), [(f"`{name}`", why) for name, why in NOT_COMPENSATED.items()])
    report.notes += [f"{text[0].upper()}{text[1:]}." for text in LEFT_TO_THE_LOOP.values()]
    report.notes += [
        f"Effects: {len(names)} of {len(TRIALS)}; axes of each: {len(kinds)}. {len(reference.seeds)} seeds of "
        f"reference and noise, {reference.duration_s:g} s each; the first is that of the records.",
        f"An excess counts if it exceeds {SIGNIFICANT:g} standard errors of its mean over the seeds.",
        "Nothing left: with the file of a new `identify` there is no significant excess, or the torque for effects "
        f"under the adopted one is below {100.0 * LEAST_GIVEN:g} % of Fc.",
    ]
    return finish(report, chosen)


if __name__ == "__main__":
    main(run)
