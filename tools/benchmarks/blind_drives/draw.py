"""A drive from a seed: its parameters, the names of its effects, and their parameters except for the strength.

Of five seeds in a row three have effects: of six such drives four have one of the library, one has two, and one has an
effect that is in no library. The order of names is a permutation per round, so that each comes as often as another.
Drives of the odd kinds alone come in turn: each of the ten once in ten seeds. So do drives with one wave of 12 to 72
periods a turn and at least 15 % of Coulomb friction: cogging, torque ripple and friction ripple.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from fffo_drive.drive.simulated.effects.registry import EFFECTS
from fffo_drive.drive.simulated.parameters import EffectConfig, PlantConfig, ResolverConfig, ThermalConfig
from fffo_drive.drive.simulated.surfaces import PlantFriction, SingleSurface

from .simulate import Gains

Draw = np.random.Generator

# changes of parameters that any base model has: a refit takes them in, and nothing is left to be found
IN_THE_BASE = ("stribeck_shape", "presliding_shape", "frictional_lag", "delay")
# the axes on which an effect of no library is rightly found; the first says it best. Torque is current times Kt.
ODD_AXES = {
    "odd_speed_band": ("velocity",),
    "odd_direction_angle": ("output_angle", "direction"),
    "odd_fatigue": ("memory", "time"),
    "odd_stick_patch": ("motor_angle",),
    "odd_current_heating": ("memory", "current", "torque"),
    "odd_two_levels": ("velocity", "memory"),
    "odd_alternate_turns": ("motor_angle", "output_angle"),
    "odd_eddy_brake": ("current", "torque", "velocity"),
    "odd_late_kick": ("travel_since_reversal",),
    "odd_cable": ("memory", "travel_since_reversal"),
}
ORDERS = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0)
MANY_PERIODS = range(4, 73)  # waves a turn: slots, poles and their least common multiple
MIXED, ODD, STRONG_WAVES = "mixed", "odd", "waves"  # what a set is drawn from
WAVES = ("cogging", "torque_ripple", "friction_ripple")
FEWEST_PERIODS, MOST_PERIODS, STRONG_SHARE = 12, 72, 0.15  # a turn; amplitude over Coulomb friction, of a strong wave
SMALL_MOTOR_A = 2.5
WITH_EFFECTS = 3  # of
OF_SEEDS = 5


@dataclass(frozen=True)
class Variant:
    """An effect whose parameters are drawn, all but one: the strength, which `strength.py` finds."""

    name: str
    strength: str
    lowest: float  # of the strength, in size
    highest: float
    sign: float
    fixed: dict[str, float]
    least_share: float = 0.0  # of the friction torque, or of its rms where the effect is a wave of many periods

    @property
    def first(self) -> float:
        """A strength to begin a search with."""
        return 0.6 if self.name == "voltage_limit" else math.sqrt(self.lowest * self.highest)

    def at(self, size: float) -> EffectConfig:
        """The effect at a strength."""
        shared = {"resolver_error": ("second_rev", 0.5)}.get(self.name)
        more = {shared[0]: shared[1] * size} if shared else {}
        return EffectConfig(self.name, {**self.fixed, **more, self.strength: self.sign * size})


def kind_of(seed: int, kinds: str = MIXED) -> tuple[int, bool]:
    """How many effects a drive of this seed has, and whether one is in no library."""
    if kinds != MIXED:
        return 1, kinds == ODD
    place = seed % OF_SEEDS
    if place >= WITH_EFFECTS:
        return 0, False
    turn = (WITH_EFFECTS * (seed // OF_SEEDS) + place) % 6
    return (2 if turn == 4 else 1), turn == 5


def effect_names(seed: int, kinds: str = MIXED) -> list[str]:
    """Names of which the first is that of this seed; the others may stand beside it."""
    if kinds == ODD:
        return [sorted(ODD_AXES)[seed % len(ODD_AXES)]]
    if kinds == STRONG_WAVES:
        return [WAVES[seed % len(WAVES)]]
    _, odd = kind_of(seed)
    known = sorted(name for name in EFFECTS if name.startswith("odd_") == odd)
    left = [name for name in known if name not in IN_THE_BASE and name != "thermal_drift"]
    number = WITH_EFFECTS * (seed // OF_SEEDS) + seed % OF_SEEDS
    place = number // 6 if odd else number - number // 6
    order = np.random.default_rng((place // len(left), 5 if odd else 4)).permutation(len(left))
    turned = np.roll(order, -(place % len(left)))
    return [left[k] for k in turned]


def base_plant(draw: Draw, seed: int, kind: str = "single_2sep") -> PlantConfig:
    """A small servo axis with a gear of 160:1 and a resolver of 15 bits, without effects."""

    def between(low: float, high: float) -> float:
        return float(np.exp(draw.uniform(math.log(low), math.log(high))))

    coulomb_nm = between(0.018, 0.036)
    single = SingleSurface(
        coulomb_nm=coulomb_nm,
        stiction_nm=coulomb_nm * between(1.4, 2.8),
        viscous_nm_per_rps=between(0.002, 0.0045),
        stribeck_rps=between(0.45, 1.3),
        stribeck_exponent=between(0.85, 1.5),
        stiffness_per_rev=between(500.0, 1300.0),
        attraction_nm_per_rev=between(1.5, 4.0),
    )
    friction = PlantFriction(kind=kind, single=single)
    if kind == "five_surfaces":
        friction = friction.scaled(level=between(0.75, 1.4), rise=between(0.7, 1.2))
    return PlantConfig(
        inertia_kg_m2=between(1.0e-4, 2.6e-4),
        rated_current_a=float(draw.choice([SMALL_MOTOR_A, 4.0, 8.3])),
        delay_s=draw.uniform(0.0026, 0.0036),
        friction=friction,
        roughness_nm=between(0.0002, 0.0006),
        roughness_hz=between(6.0, 25.0),
        thermal=ThermalConfig(viscous_per_k=0.0, coulomb_per_k=0.0),
        resolver=ResolverConfig(tracking_hz=between(300.0, 600.0)),
        initial_angle_rev=round(float(draw.uniform(0.0, 1.0)), 3),
        seed=seed,
    )


def with_limits(plant: PlantConfig, names: list[str]) -> PlantConfig:
    """The same with a peak current of twice the rated one, and a small motor where its iron is to saturate."""
    if "torque_saturation" in names:
        plant = replace(plant, rated_current_a=SMALL_MOTOR_A)
    return replace(plant, peak_current_a=2.0 * plant.rated_current_a)


def gains_of(plant: PlantConfig) -> Gains:
    """A PI controller whose bandwidth is the same on every drive."""
    torque_per_a = plant.torque_constant_nm_per_a
    inertia = 2.0 * math.pi * plant.inertia_kg_m2
    proportional = 150.0 * inertia / torque_per_a
    return Gains(proportional, 10.0 * proportional, plant.peak_current_a, plant.rated_current_a / 1000.0)


def chirp_current_a(plant: PlantConfig) -> float:
    """A current that gives speed, but less than what the supply allows."""
    friction = plant.friction
    return min(1.1, (friction.coulomb_nm + 36.0 * friction.viscous_nm_per_rps) / plant.torque_constant_nm_per_a)


def variant(draw: Draw, name: str, kinds: str = MIXED) -> Variant:
    """Everything about an effect but its strength."""
    make = _VARIANTS[name]
    drawn = make(draw, name)
    if kinds == STRONG_WAVES:
        order = round(_log(FEWEST_PERIODS, MOST_PERIODS)(draw))
        return replace(drawn, fixed={**drawn.fixed, "order": float(order)}, least_share=STRONG_SHARE / math.sqrt(2.0))
    return drawn


def _one(
    strength: str,
    lowest: float,
    highest: float,
    signed: bool = False,
    **shapes: Callable[[Draw], float],
) -> Callable[[Draw, str], Variant]:
    def make(draw: Draw, name: str) -> Variant:
        sign = float(draw.choice([-1.0, 1.0])) if signed else 1.0
        fixed = {key: float(shape(draw)) for key, shape in shapes.items()}
        return Variant(name, strength, lowest, highest, sign, fixed)

    return make


def _log(low: float, high: float) -> Callable[[Draw], float]:
    return lambda draw: float(np.exp(draw.uniform(math.log(low), math.log(high))))


def _even(low: float, high: float) -> Callable[[Draw], float]:
    return lambda draw: float(draw.uniform(low, high))


def _order(draw: Draw) -> float:
    """Half of them many periods a turn, all octaves alike; else mostly whole, at times half, gear-related or free."""
    if draw.uniform() < 0.5:
        weights = 1.0 / np.array(MANY_PERIODS)
        return float(draw.choice(MANY_PERIODS, p=weights / weights.sum()))
    kind = draw.uniform()
    if kind < 0.65:
        return float(draw.choice(ORDERS))
    if kind < 0.8:
        return float(draw.choice([0.5, 1.5, 2.5, 3.5]))
    if kind < 0.9:
        return float(draw.choice([2.0, 3.0, 4.0, 8.0])) / 160.0 * float(draw.choice([1.0, 10.0]))
    return round(float(draw.uniform(0.3, 9.0)), 3)


_PHASE = _even(0.0, 1.0)


def _position(draw: Draw, name: str) -> Variant:
    period_rev = float(np.exp(draw.uniform(math.log(6.0), math.log(80.0))))
    if draw.uniform() < 0.5:
        return Variant(name, "wave_share", 0.01, 0.9, float(draw.choice([-1.0, 1.0])), {"period_rev": period_rev})
    window = {"wave_share": 0.0, "period_rev": period_rev, "centre_rev": draw.uniform(0.0, period_rev)}
    window["width_rev"] = draw.uniform(0.15, 0.4) * period_rev
    return Variant(name, "window_share", 0.01, 2.0, 1.0, window)


def _two_levels(draw: Draw, name: str) -> Variant:
    lies_rps = draw.uniform(1.0, 3.0)
    return Variant(
        name, "share", 0.02, 3.0, 1.0, {"lies_rps": lies_rps, "lifts_rps": lies_rps * draw.uniform(2.0, 4.0)}
    )


_VARIANTS: dict[str, Callable[[Draw, str], Variant]] = {
    "torque_offset": _one("torque_nm", 0.0005, 0.1, signed=True),
    "asymmetric_coulomb": _one("share", 0.01, 0.8, signed=True),
    "asymmetric_viscous": _one("share", 0.01, 0.8, signed=True),
    "dwell_stiction": _one(
        "rise_share",
        0.05,
        6.0,
        time_constant_s=_log(0.5, 4.0),
        release_rev=_log(0.02, 0.15),
        rest_rps=_even(0.04, 0.08),
    ),
    "load_dependent_friction": _one("share", 0.01, 0.8),
    "position_dependent_friction": _position,
    "friction_ripple": _one("share", 0.01, 0.9, order=_order, phase_rev=_PHASE),
    "coulomb_drift": _one("share", 0.02, 0.85, signed=True, time_constant_s=_log(40.0, 400.0)),
    "viscous_drift": _one("share", 0.02, 0.85, signed=True, time_constant_s=_log(40.0, 400.0)),
    "quadratic_drag": _one("drag_nm_per_rps2", 2e-6, 0.002),
    "cogging": _one("amplitude_nm", 0.0005, 0.2, order=_order, phase_rev=_PHASE),
    "torque_ripple": _one("share", 0.01, 0.8, order=_order, phase_rev=_PHASE),
    "unbalance": _one("amplitude_nm", 0.0005, 0.2, phase_rev=_PHASE),
    "periodic_disturbance": _one("amplitude_nm", 0.0005, 0.2, frequency_hz=_log(0.4, 25.0), phase_rev=_PHASE),
    "torque_saturation": _one("share", 0.02, 1.0),
    "dead_zone": _one("width_a", 0.005, 0.5),
    "voltage_limit": _one("drop_share", 0.1, 0.93),
    "current_lag": _one("time_constant_s", 0.0005, 0.02),
    "elasticity": _one("load_share", 0.02, 0.7, frequency_hz=_log(12.0, 45.0), damping=_log(0.02, 0.1)),
    "backlash": _one(
        "gap_rev",
        0.001,
        0.15,
        load_share=_even(0.2, 0.6),
        friction_share=_even(0.1, 0.5),
        contact_hz=_even(150.0, 350.0),
    ),
    "resolver_error": _one("first_rev", 0.00002, 0.01, first_phase_rev=_PHASE, second_phase_rev=_PHASE),
    "odd_speed_band": _one("amplitude_nm", 0.001, 0.2, centre_rps=_even(4.0, 9.0), width_rps=_even(0.7, 2.0)),
    "odd_direction_angle": _one("amplitude_nm", 0.001, 0.2, phase_rev=_PHASE),
    "odd_fatigue": _one("share", 0.05, 0.9, travel_rev=_log(8.0, 30.0), recovery_s=_log(4.0, 15.0)),
    "odd_stick_patch": _one(
        "amplitude_nm", 0.002, 0.4, centre_rev=_PHASE, width_rev=_even(0.06, 0.2), fades_rps=_log(0.6, 3.0)
    ),
    "odd_current_heating": _one("share", 0.2, 100.0, time_constant_s=_log(2.0, 10.0)),
    "odd_two_levels": _two_levels,
    "odd_alternate_turns": _one("share", 0.02, 3.0, turns=lambda draw: float(draw.integers(2, 6))),
    "odd_eddy_brake": _one("brake_nm_per_rps", 0.001, 0.9),
    "odd_late_kick": _one("amplitude_nm", 0.002, 0.3, after_rev=_even(0.1, 0.4), width_rev=_even(0.04, 0.1)),
    "odd_cable": _one("torque_nm", 0.001, 0.2, reach_rev=_even(0.8, 4.0)),
}


def effect_draws(seed: int) -> Draw:
    """The generator of a drive's effects, apart from that of its parameters."""
    return np.random.default_rng((seed, 2))


def plant_draws(seed: int, attempt: int = 0) -> Draw:
    """The generator of a drive's parameters; an attempt of its own for each plant that could not have its effect."""
    return np.random.default_rng((seed, 1, attempt) if attempt else (seed, 1))
