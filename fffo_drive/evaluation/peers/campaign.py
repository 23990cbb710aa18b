"""Other laws beside the controllers of a scenario: the same seeds and references, margins, and errors of the model.

They have the gains, inertia torque, preview and error filter of the scenario's PI+FFFO+. Their friction models are
fitted to a run on the same simulated axis.
"""

from __future__ import annotations

from typing import NamedTuple

from ...arrays import Floats
from ..campaign import Candidate, Case, Evaluation, evaluation_of
from .laws import PLUS, Models, design_for, fit_models, peers_of, with_friction, wrong
from .loop import PeerLaw, run_law

FIT_SEED = 1000  # of the record that the models are fitted to; no seed that is evaluated


class FittedModels(NamedTuple):
    """What the laws know of the friction of an axis."""

    models: Models
    left: tuple[float, ...]  # share of the friction (rms) that each of them leaves


class FrictionRecord(NamedTuple):
    """What the models are fitted to, arrays (n,)."""

    velocity_rps: Floats  # of the shaft
    friction_nm: Floats  # the plant's own
    period_s: float


def friction_record(case: Case) -> FrictionRecord:
    """One run of PI+FFFO+ on the axis of a case, which follows the reference.

    Raises ValueError if the case has no such controller.
    """
    follower = plus_of(case)
    ran = run_law(case.plant, case.device, PeerLaw(PLUS, follower.controller, follower.toggle), case.profile)
    assert ran.trace.true_rps is not None
    return FrictionRecord(ran.trace.true_rps, ran.friction_nm, case.profile.period_s)


def fitted_models(case: Case) -> FittedModels:
    """The models along `friction_record`. Raises ValueError as it does."""
    return FittedModels(*fit_models(*friction_record(case)))


def plus_of(case: Case) -> Candidate:
    """PI+FFFO+ of a case, with inertia torque and preview. Raises ValueError if it has none."""
    for candidate in case.candidates:
        shifts = candidate.controller.feedforward
        if candidate.name == PLUS and shifts.inertia_nm_s2_per_rev > 0.0 and shifts.ahead_ticks > 0.0:
            return candidate
    raise ValueError(
        f"controllers: no {PLUS} with inertia, preview and delay_aware. The published laws take their gains and "
        "margins from it: add it"
    )


def run_peers(case: Case, models: Models, mismatch_share: float, sign: float | None) -> list[Evaluation]:
    """All other laws on one seed; each number of their friction is wrong by `mismatch_share`.

    `sign`: of these errors; None: drawn by the seed. Raises ValueError as `plus_of`, and where no gain of a disturbance
    observer has the margins of PI+FFFO+.
    """
    candidate = plus_of(case)
    known = wrong(models, mismatch_share, case.seed, sign)
    plus = with_friction(candidate.controller, known.two_state)
    laws = peers_of(plus, candidate.toggle, design_for(plus), known)
    return [
        evaluation_of(
            law.name, case.seed, [run_law(case.plant, case.device, law, case.profile).trace], case.yardstick,
            case.cutouts_s,
        )
        for law in laws
    ]  # fmt: skip
