"""Diagnosis of a rigid linear axis by its force balance: from records to a `Diagnosis`, as the page and report take it.

Effects are chosen on one fit record alone. A periodic effect has a datum per run (a counter that starts anew knows no
angle): it is left out on the held-out record, and what it would take away there, with its datum found on the first
quarter, is said apart. The hold of a sampled command is in the base: it is no effect, but how any command acts.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import __version__
from ..identification.dataset import DataError, Record
from ..identification.facts import DriveFacts
from ..identification.rigid import RigidSettings, fit_rigid, rigid_error_percent
from ..model.effects.registry import LAWS
from ..model.parameters import EffectModel, FrictionModel, ModelFile, Provenance, Quantity, effect_model
from ..units import inertia_kg_m2
from . import results as out
from .rigid_data import RigidRun, cycle_rows, rigid_run
from .rigid_fitted import (
    BINS,
    RigidFitted,
    abscissa_of,
    binned,
    columns_of,
    edges_of,
    explained_by,
    fitted_to,
    is_periodic,
    residual_of,
)
from .rigid_search import FALSE_ALARMS, RigidSearch, RigidTerm, Rival, matrix_of, rivals, search

Floats = npt.NDArray[np.float64]
Progress = Callable[[float, str], None]

WINDOW_S = 0.5  # of a free run in velocity
RESAMPLES = 2000
DATUM_SHARE = 0.25  # of a held-out run, for the datum of a periodic effect
MOST_ALTERNATIVES = 2
ENVELOPE = 400
LINEAR = {"Nm": "N", "rev": "m", "rps": "m/s", "Nm/rps": "N s/m", "1/rev": "1/m"}
ACTING_SHARE = 0.5  # of the largest force of an effect: where it acts


def diagnose_rigid(
    fit: Record, held_out: Sequence[Record], facts: DriveFacts, progress: Progress | None = None
) -> out.Diagnosis:
    """Find what the rigid model of a linear axis lacks. Raises DataError for a record with gaps."""
    begin = time.monotonic()
    tell = progress or (lambda share, text: None)
    for record in (fit, *held_out):
        if record.breaks:
            raise DataError(f"{record.path}: gaps in time; the force balance of a rigid axis needs a run without")
    tell(0.05, "force balance")
    run = rigid_run(fit)
    tell(0.1, "search")
    found = search(run, facts.gear_ratio)
    tell(0.7, "rivals")
    fitted = fitted_to(run, found.terms)
    base = fitted_to(run, [])
    near = [rivals(run, found, k, facts.gear_ratio) for k in range(len(found.terms))]
    tell(0.9, "proof")
    unseen = [rigid_run(record, run.axis) for record in held_out]
    before, after = _figures(unseen, base, facts), _figures(unseen, fitted, facts)
    fit_before, fit_after = _figures([run], base, facts), _figures([run], fitted, facts, own=True)
    assert fit_before is not None
    assert fit_after is not None
    findings = [_finding(run, unseen, fitted, found, k, near[k], facts) for k in range(len(found.terms))]
    findings += [_rejected(term, reason, share, facts) for term, reason, share in found.rejected]
    findings.sort(key=lambda finding: (not finding.accepted, -finding.explained_fraction))
    model_before, model_after = _model(run, base, "before"), _model(run, fitted, "after")
    diagnosis = out.Diagnosis(
        verdict="effects_found" if found.terms else "no_effect_found",
        headline=_headline(found, before, after, fit_before, fit_after),
        findings=tuple(findings),
        before=before,
        after=after,
        fit_before=fit_before,
        fit_after=fit_after,
        ceiling=_ceiling(run, base, fitted),
        channels=_channels(run, base, fitted),
        runs=tuple(_envelope(r, base, fitted, "fit" if r is run else "held_out", facts) for r in (run, *unseen)),
        model_before=model_before,
        model_after=model_after,
        false_alarm_rate=FALSE_ALARMS,
        units="linear",
        cautions=tuple(_cautions(run, unseen, fitted, facts)),
        settings={"method": "force balance of a rigid axis", "hold": hold_figures(fit, held_out)},
        seconds=time.monotonic() - begin,
        fit_names=(fit.name,),
        held_out_names=tuple(record.name for record in held_out),
    )
    tell(1.0, "done")
    return diagnosis


def hold_figures(fit: Record, held_out: Sequence[Record]) -> dict[str, dict[str, float]]:
    """Relative force error of the rigid model with symmetric friction and offset, without and with the hold."""
    figures: dict[str, dict[str, float]] = {}
    for name, hold in (("without_hold", False), ("with_hold", True)):
        settings = RigidSettings(hold=hold)
        base = fit_rigid(fit, settings)
        figures[name] = {fit.name: base.error_percent} | {
            record.name: rigid_error_percent(record, base.parameters, settings) for record in held_out
        }
    return figures


def _figures(
    runs: Sequence[RigidRun], fitted: RigidFitted, facts: DriveFacts, own: bool = False, where: Sequence[Floats] = ()
) -> out.ErrorFigures | None:
    """Errors over runs, on the rows of `where` if given; None where no row is left."""
    residuals, forces, speeds, pieces = [], [], [], []
    offset = 0
    for number, run in enumerate(runs):
        left = residual_of(run, fitted, facts, own)
        kept = where[number].astype(bool) if where else np.ones(left.size, bool)
        piece = np.arange(left.size) // max(1, round(WINDOW_S / run.row_period_s))
        residuals.append(left[kept])
        forces.append(run.force[kept])
        speeds.append(_velocity_error(run, left, float(fitted.values[0]), piece)[kept])
        pieces.append(piece[kept] + offset)
        offset += int(piece.max()) + 1
    if not runs or not sum(r.size for r in residuals):
        return None
    window = np.unique(np.concatenate(pieces), return_inverse=True)[1]
    sums = np.stack([
        np.bincount(window, np.concatenate(parts) ** 2) for parts in (residuals, forces, speeds)
    ])  # fmt: skip
    counts = np.bincount(window).astype(float)
    generator = np.random.default_rng(5)
    drawn = generator.multinomial(counts.size, np.full(counts.size, 1.0 / counts.size), RESAMPLES).astype(float)

    def interval(top: Floats, bottom: Floats, scale: float = 1.0) -> out.Interval:
        spread = scale * np.sqrt((drawn @ top) / np.maximum(drawn @ bottom, 1e-300))
        low, high = np.quantile(spread, [0.025, 0.975])
        return out.Interval(scale * float(np.sqrt(top.sum() / bottom.sum())), float(low), float(high))

    return out.ErrorFigures(
        torque_rms_nm=interval(sums[0], counts),
        torque_relative_percent=interval(sums[0], sums[1], 100.0),
        velocity_rms_rps=interval(sums[2], counts),
        seconds=float(counts.sum() * runs[0].row_period_s),
    )


def _velocity_error(run: RigidRun, left: Floats, inertia: float, piece: npt.NDArray[np.int64]) -> Floats:
    """What the force that is left makes of the speed from the begin of each piece, friction as in the motion. (m,)"""
    path = np.cumsum(left) * run.row_period_s / inertia
    starts = np.concatenate([[0], np.flatnonzero(np.diff(piece)) + 1])
    return np.asarray(path - path[starts][piece])


def _headline(
    found: RigidSearch,
    before: out.ErrorFigures | None,
    after: out.ErrorFigures | None,
    fit_before: out.ErrorFigures,
    fit_after: out.ErrorFigures,
) -> str:
    if not found.terms:
        return "Nothing was found that a rigid model with symmetric friction and offset lacks."
    names = ", ".join(dict.fromkeys(term.name for term in found.terms))
    first, last = (before, after) if before is not None and after is not None else (fit_before, fit_after)
    place = "held-out" if before is not None else "fit"
    return (
        f"Found: {names}. Force error on the {place} data from {first.torque_relative_percent.value:.2f} to "
        f"{last.torque_relative_percent.value:.2f} %."
    )


def _finding(
    run: RigidRun,
    unseen: Sequence[RigidRun],
    fitted: RigidFitted,
    found: RigidSearch,
    which: int,
    near: Sequence[Rival],
    facts: DriveFacts,
) -> out.Finding:
    term, law = fitted.terms[which], LAWS[fitted.terms[which].name]
    own = fitted.span(which)
    force = term.columns @ fitted.values[own]
    friction = run.base[:, 1:3] @ fitted.values[1:3]
    acting = [np.abs(columns_of(r, term) @ fitted.values[own]) for r in unseen]
    acting = [a > ACTING_SHARE * np.quantile(np.abs(force), 0.98) for a in acting]
    without = RigidFitted(
        tuple(t for k, t in enumerate(fitted.terms) if k != which),
        np.delete(fitted.values, np.arange(own.start, own.stop)),
        np.delete(fitted.sd, np.arange(own.start, own.stop)),
    )
    shown = bool(unseen) and not is_periodic(term, facts)
    return out.Finding(
        name=term.name,
        alternatives=tuple(r.name for r in near if r.not_told_apart)[:MOST_ALTERNATIVES],
        axis=law.axis,
        parameters=tuple(_numbers(term, fitted.values[own], fitted.sd[own])),
        explained_fraction=found.explained[which],
        false_alarm_probability=term.probability,
        accepted=True,
        reason=found.reasons[which],
        regime=law.regime,
        experiment=law.experiment,
        compensable=law.compensable and not is_periodic(term, facts),
        strength_percent=100.0 * float(np.sqrt(np.mean(force**2) / np.mean(friction**2))),
        rivals=tuple(out.Rival(r.name, r.loss_ratio, r.collinearity, r.not_told_apart) for r in near[:6]),
        picture=_picture(run, fitted, which),
        regime_before=_figures(unseen, without, facts, where=acting) if shown else None,
        regime_after=_figures(unseen, fitted, facts, where=acting) if shown else None,
    )


def _rejected(term: RigidTerm, reason: str, share: float, facts: DriveFacts) -> out.Finding:
    law = LAWS[term.name]
    shapes = tuple(_numbers(term, np.zeros(0), np.zeros(0)))
    return out.Finding(
        term.name, (), law.axis, shapes, share, term.probability, False, reason, law.regime, law.experiment,
        law.compensable, 0.0,
    )  # fmt: skip


def _numbers(term: RigidTerm, values: Floats, sd: Floats) -> list[out.Number]:
    units = {p.name: LINEAR.get(p.unit, p.unit) for p in LAWS[term.name].parameters}
    strengths = [
        out.Number(name, float(values[k]), float(sd[k]), units[name])
        for k, name in enumerate(term.strengths)
        if k < values.size
    ]
    return strengths + [out.Number(name, float(value), None, units[name]) for name, value in term.shape.items()]


def _picture(run: RigidRun, fitted: RigidFitted, which: int) -> out.Picture:
    term, own = fitted.terms[which], fitted.span(which)
    force = term.columns @ fitted.values[own]
    left = run.force - matrix_of(run, fitted.terms) @ fitted.values
    x, label, unit = abscissa_of(run, term)
    even = label.startswith("log10")
    edges = np.linspace(x.min(), x.max(), BINS + 1) if even else edges_of(x)
    filled = np.histogram(x, edges)[0] > 0
    place = binned(x, x, edges)[0][filled]
    curves = []
    for name, values in (("without the effect", left + force), ("with it", left)):
        mean, reach = (part[filled] for part in binned(x, values, edges))
        curves.append(out.Curve(name, place, mean, mean - reach, mean + reach, "points"))
    curves.append(out.Curve("what the effect says", place, binned(x, force, edges)[0][filled], kind="line"))
    return out.Picture(
        f"{term.name} over {label}", label, unit, "force that is left", "N", tuple(curves),
        "Means over rows of the fit run; intervals take the rows as independent.",
    )  # fmt: skip


def _ceiling(run: RigidRun, base: RigidFitted, fitted: RigidFitted) -> out.Ceiling:
    cycle = cycle_rows(run.velocity)
    if cycle is None or run.force.size < 2 * cycle:
        return out.Ceiling(None, None, None, "no motion was repeated")
    left = run.force - run.base @ base.values
    repeats = run.force.size // cycle
    stack = left[: repeats * cycle].reshape(repeats, cycle)
    noise = float(stack.var(axis=0, ddof=1).mean())
    whole = float(np.mean(stack**2))
    after = float(np.mean((run.force - matrix_of(run, fitted.terms) @ fitted.values) ** 2))
    repeatable = max(1e-300, whole - noise)
    note = f"{repeats} repeats of a motion of {cycle * run.row_period_s:.2f} s on the fit run"
    return out.Ceiling(repeatable / whole, noise**0.5, min(1.0, max(0.0, (whole - after) / repeatable)), note)


def _channels(run: RigidRun, base: RigidFitted, fitted: RigidFitted) -> tuple[out.Channel, ...]:
    """Share of the residual that free means over one axis explain, against the same residual shifted round the run."""
    axes = {
        "time": run.time_s,
        "velocity": run.velocity,
        "direction": np.sign(run.velocity),
        "acceleration": run.acceleration,
        "motor_angle": run.position,
        "travel_since_reversal": run.travel,
    }
    generator = np.random.default_rng(7)
    lefts = [run.force - run.base @ base.values, run.force - matrix_of(run, fitted.terms) @ fitted.values]
    found = []
    for name, x in axes.items():
        edges = np.array([-1.5, 0.0, 1.5]) if name == "direction" else edges_of(x)
        shares, significant = [], []
        for left in lefts:
            share = explained_by(x, left, edges)
            offsets = generator.integers(left.size // 20, left.size - left.size // 20, 200)
            chance = [explained_by(x, np.roll(left, int(offset)), edges) for offset in offsets]
            shares.append(share)
            significant.append(bool(share > np.quantile(chance, 1.0 - FALSE_ALARMS)))
        found.append(out.Channel(name, shares[0], shares[1], significant[0], significant[1], run.force.size))
    return tuple(found)


def _envelope(run: RigidRun, base: RigidFitted, fitted: RigidFitted, role: Any, facts: DriveFacts) -> out.RunFigure:
    step = max(1, run.force.size // ENVELOPE)
    size = run.force.size // step * step
    before, after = (residual_of(run, f, facts, role == "fit")[:size].reshape(-1, step) for f in (base, fitted))
    return out.RunFigure(
        run.record.name, role, run.time_s[:size:step], before.min(axis=1), before.max(axis=1), after.min(axis=1),
        after.max(axis=1),
    )  # fmt: skip


def _cautions(run: RigidRun, unseen: Sequence[RigidRun], fitted: RigidFitted, facts: DriveFacts) -> list[str]:
    found = [
        "torque_offset and asymmetric_coulomb cannot be told apart on one axis: both stand in the base as an offset"
    ]
    for k, term in enumerate(fitted.terms):
        if not is_periodic(term, facts):
            continue
        for other in unseen:
            percent = _with_datum(other, fitted, k, facts)
            found.append(
                f"{term.name} has a datum per run: it is left out on {other.record.name}. With its datum found on the "
                f"first quarter of that run the error of the rest goes from {percent[0]:.2f} to {percent[1]:.2f} %"
            )
    return found


def _with_datum(run: RigidRun, fitted: RigidFitted, which: int, facts: DriveFacts) -> tuple[float, float]:
    """Error on the rest of a run, in per cent, without and with a periodic effect whose datum its begin gave."""
    left = residual_of(run, fitted, facts, own=False)
    columns = columns_of(run, fitted.terms[which])
    first = round(DATUM_SHARE * left.size)
    values = np.linalg.lstsq(columns[:first], left[:first], rcond=None)[0]
    rest = slice(first, None)
    scale = 100.0 / float(np.linalg.norm(run.force[rest]))
    corrected = left[rest] - columns[rest] @ values
    return scale * float(np.linalg.norm(left[rest])), scale * float(np.linalg.norm(corrected))


def _model(run: RigidRun, fitted: RigidFitted, name: str) -> ModelFile:
    """The model file: the rigid base as a 2SEP model with a stiff contact and no rise of friction at rest."""

    def fitted_value(k: int, factor: float = 1.0) -> Quantity:
        return Quantity(value=float(fitted.values[k]) * factor, sd=float(fitted.sd[k]) * factor, source="fitted")

    friction = run.axis.friction
    assumed = "assumed: a rigid model has none"
    effects = [
        EffectModel(
            name="torque_offset",
            parameters={"torque_nm": fitted_value(3)},
            alternatives=["asymmetric_coulomb"],
            provenance="offset of the rigid base",
        )
    ]
    for k, term in enumerate(fitted.terms):
        own = fitted.span(k)
        values = dict(zip(term.strengths, fitted.values[own].tolist(), strict=True))
        sd = dict(zip(term.strengths, fitted.sd[own].tolist(), strict=True))
        periodic = bool(set(LAWS[term.name].per_run) & set(term.strengths))
        effects.append(effect_model(term.name, {**values, **term.shape}, sd, datum="run" if periodic else "absolute"))
    return ModelFile(
        name=f"{run.record.name}, {name}",
        torque_constant_nm_per_a=run.record.torque_constant_nm_per_a,
        inertia_kg_m2=fitted_value(0, inertia_kg_m2(1.0)),
        delay_s=Quantity(value=0.0, source="the hold alone"),
        friction=FrictionModel(
            viscous_nm_per_rps=fitted_value(1),
            coulomb_nm=fitted_value(2),
            static_nm=fitted_value(2),
            stribeck_velocity_rps=Quantity(value=friction.stribeck_velocity_rps, source=assumed),
            stribeck_exponent=Quantity(value=1.0, source=assumed),
            stiffness_per_rev=Quantity(value=friction.stiffness_per_rev, source=assumed),
            attraction_nm_per_rev=Quantity(value=friction.attraction_nm_per_rev, source=assumed),
        ),
        effects=effects,
        provenance=Provenance(
            date=time.strftime("%Y-%m-%d"), tool=f"fffo-drive {__version__} diagnose", runs=[run.record.digest]
        ),
    )
