"""Adaptation to slow change: offset, Coulomb and viscous friction, learned from the torque of the feedback.

As lubricant warms up, a model that was identified in the morning is wrong at noon. The torque fed forward for it is

    A = p_0 + p_1 c(t) + p_2 w_r(t),    c = F (1 - sigma |w_r| / |S(w_r)|) / Fc

with the reference w_r read ahead and the 2SEP friction F on it: c is the contact's part of the friction, about +-1 in
steady motion, with the presliding shape at a reversal. The P and I terms are the torque that the model still lacks, as
far as the loop has found it, so they are the training signal (feedback-error learning: M. Kawato, K. Furukawa and
R. Suzuki, 1987; J. Nakanishi and S. Schaal, 2004). The step is that of least squares on moments over a time T:

    dp/dt = R^-1 g / 2T,    R = mean of phi phi',    g = mean of phi Kt (P + I),    phi = (1, c, w_r)

so that all three settle alike at any amplitude of the motion, with a damping of 0.7. T is far longer than any time
constant of the loop, and each p is bounded, as is its rate (bound over T). For the loop, A is therefore a bounded input
that changes slowly, and (11) and (14) remain valid.

Offset and Coulomb friction cannot be distinguished on an axis that turns one way, nor viscous from Coulomb friction at
one speed. A parameter that the motion of the last T does not excite is not adapted.
"""

from __future__ import annotations

from typing import NamedTuple

from ..jit import njit
from ..model.friction import FrictionConfig, steady_friction_nm

# share of a regressor's power that those before it must leave for it to count as excited
# (tools/benchmarks/results/adaptation.md)
EXCITED_SHARE = 0.1
FOLLOWS_IN = 2.0  # T: the parameters behind the means; two first-order lags of T and 2 T in a loop are damped by 0.7

# bits: what has reached its bound
OFFSET_AT_BOUND = 1
COULOMB_AT_BOUND = 2
VISCOUS_AT_BOUND = 4


class AdaptationConfig(NamedTuple):
    """Constants of the adaptation."""

    used: bool
    step_share: float  # period / T
    torque_bound_nm: float  # of offset and Coulomb friction
    viscous_bound_nm_per_rps: float


NO_ADAPTATION = AdaptationConfig(False, 0.0, 0.0, 0.0)


class AdaptationState(NamedTuple):
    """Memory: learned parameters, and moments of the motion of the last T."""

    offset_nm: float
    coulomb_nm: float
    viscous_nm_per_rps: float
    weight: float  # of the means: 1 - exp(-t/T) after a time t in motion
    c: float  # means: of c
    c2: float  # ... of c^2
    w: float  # ... of w_r
    cw: float  # ... of c w_r
    w2: float  # ... of w_r^2
    r: float  # ... of the torque of P and I
    cr: float  # ... times c
    wr: float  # ... times w_r


class Adapted(NamedTuple):
    """Output of a tick."""

    contact: float  # c
    torque_nm: float  # A; 0 unless friction is computed on the reference


NOTHING_ADAPTED = Adapted(0.0, 0.0)


@njit
def adaptation_at_start() -> AdaptationState:
    """Memory with nothing learned: at the start of a loop, and with a new model."""
    return AdaptationState(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@njit
def adapted_torque(
    friction: FrictionConfig, state: AdaptationState, friction_nm: float, velocity_rps: float
) -> Adapted:
    """A on a reference and its friction."""
    steady_nm = steady_friction_nm(friction, velocity_rps)
    viscous_share = friction.viscous_nm_per_rps * abs(velocity_rps) / steady_nm
    contact = friction_nm * (1.0 - viscous_share) / friction.coulomb_nm
    torque_nm = state.offset_nm + state.coulomb_nm * contact + state.viscous_nm_per_rps * velocity_rps
    return Adapted(contact, torque_nm)


@njit
def _moved(value: float, way: float, bound: float, step_share: float) -> float:
    """A parameter after a step, limited to its bound, and in rate to its bound over T."""
    moved = value + step_share * min(max(way / FOLLOWS_IN, -bound), bound)
    return min(max(moved, -bound), bound)


@njit
def adaptation_step(
    config: AdaptationConfig, state: AdaptationState, contact: float, velocity_rps: float, lacking_nm: float
) -> tuple[bool, AdaptationState]:
    """One tick in motion, with c and w_r. `lacking_nm`: torque of P and I. Return (whether it was learned, state)."""
    weight = state.weight + config.step_share * (1.0 - state.weight)
    share = config.step_share / weight  # of this tick in the means: they begin with it, not with zero
    c = state.c + share * (contact - state.c)
    c2 = state.c2 + share * (contact * contact - state.c2)
    w = state.w + share * (velocity_rps - state.w)
    cw = state.cw + share * (contact * velocity_rps - state.cw)
    w2 = state.w2 + share * (velocity_rps * velocity_rps - state.w2)
    r = state.r + share * (lacking_nm - state.r)
    cr = state.cr + share * (contact * lacking_nm - state.cr)
    wr = state.wr + share * (velocity_rps * lacking_nm - state.wr)
    offset_nm, coulomb_nm, viscous = state.offset_nm, state.coulomb_nm, state.viscous_nm_per_rps
    spread = c2 - c * c
    learns = spread > EXCITED_SHARE * c2
    if learns:
        a, b = (c2 * w - c * cw) / spread, (cw - c * w) / spread  # w_r = a + b c + rest
        rest_2 = w2 - a * w - b * cw
        viscous_way = (wr - a * r - b * cr) / rest_2 if rest_2 > EXCITED_SHARE * w2 else 0.0
        offset_way = (c2 * r - c * cr) / spread - a * viscous_way
        coulomb_way = (cr - c * r) / spread - b * viscous_way
        offset_nm = _moved(offset_nm, offset_way, config.torque_bound_nm, config.step_share)
        coulomb_nm = _moved(coulomb_nm, coulomb_way, config.torque_bound_nm, config.step_share)
        viscous = _moved(viscous, viscous_way, config.viscous_bound_nm_per_rps, config.step_share)
    return learns, AdaptationState(offset_nm, coulomb_nm, viscous, weight, c, c2, w, cw, w2, r, cr, wr)


@njit
def bounds_reached(config: AdaptationConfig, state: AdaptationState) -> int:
    """Bits of the parameters at their bounds: the axis has changed by more than allowed. 0 without adaptation."""
    if not config.used:
        return 0
    bits = OFFSET_AT_BOUND if abs(state.offset_nm) >= config.torque_bound_nm else 0
    bits |= COULOMB_AT_BOUND if abs(state.coulomb_nm) >= config.torque_bound_nm else 0
    return bits | (VISCOUS_AT_BOUND if abs(state.viscous_nm_per_rps) >= config.viscous_bound_nm_per_rps > 0.0 else 0)
