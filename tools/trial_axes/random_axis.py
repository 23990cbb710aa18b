"""Random axes for robustness tests of controllers whose gains were tuned to the nominal axis.

Each axis has random inertia, torque constant, friction and delay, one of several friction laws, and effects of random
strength; over all axes, every effect of the registry occurs.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fffo_drive.drive.simulated.effects.registry import EFFECTS
from fffo_drive.drive.simulated.parameters import EffectConfig, PlantConfig, ResolverConfig
from fffo_drive.drive.simulated.surfaces import PlantFriction, Surface

SPREAD = 0.3  # of the numbers of the axis
DELAY_S = (0.001, 0.005)
WIDE_SPREAD = 0.5  # of the numbers, the delay and the noise of a wide axis
ENCODER_BITS = (14, 18)  # of every other wide axis: encoder counts, without a slow tracking loop
ENCODER_TRACKING_HZ = 2000.0  # the velocity of its drive
STRONGEST = 1.5  # of an effect, in multiples of the registry's default
MORE_EFFECTS = 2  # largest number, in addition to the one whose turn it is
ELASTIC_EVERY = 3  # a third of the wide axes has an elastic load
ELASTIC_HZ = (20.0, 400.0)  # resonance of motor against load, evenly in its logarithm
ELASTIC_SHARE = (0.05, 0.6)  # of the inertia
ELASTIC_DAMPING = (0.01, 0.1)  # evenly in its logarithm
ELASTICITY = "elasticity"
FRICTION_LAWS = ("five surfaces", "2SEP", "LuGre", "Dahl", "stiff contact with high stiction")


class RandomAxis(NamedTuple):
    """A plant and its random draws."""

    number: int
    plant: PlantConfig
    law: str  # of FRICTION_LAWS
    effects: tuple[str, ...]


def random_axis(nominal: PlantConfig, number: int) -> RandomAxis:
    """Axis `number`, always the same. Raises ValueError if the draws do not give a valid drive."""
    rng = np.random.default_rng([number, 0xA])
    for _ in range(100):
        law = FRICTION_LAWS[number % len(FRICTION_LAWS)]
        names = _effect_names(number, rng)
        delay_s = float(rng.uniform(*DELAY_S))
        plant = replace(
            nominal,
            seed=number + 1,
            inertia_kg_m2=nominal.inertia_kg_m2 * _factor(rng),
            torque_constant_nm_per_a=nominal.torque_constant_nm_per_a * _factor(rng),
            delay_s=delay_s,
            resolver=_fast_enough(nominal.resolver, delay_s),
            current_bandwidth_hz=5000.0 if delay_s < 0.0022 else nominal.current_bandwidth_hz,
            friction=_friction(law, nominal.friction, rng),
            effects=tuple(_effect(name, rng) for name in names),
        )
        if not plant.errors():
            return RandomAxis(number, plant, law, names)
    raise ValueError(f"axis {number}: a hundred draws gave no drive; the last one: {plant.errors()[0]}")


def wide_axis(nominal: PlantConfig, number: int) -> RandomAxis:
    """Axis `number` with a 50 % spread of every number, the delay and the noise, with a resolver or an encoder.

    A third has an elastic load, and others may draw one from the registry. Raises ValueError when no drive can be made
    of what is drawn.
    """
    rng = np.random.default_rng([number, 0xB])
    for _ in range(100):
        names = _effect_names(number, rng)
        law = FRICTION_LAWS[number % len(FRICTION_LAWS)]
        factors = [_factor(rng, WIDE_SPREAD) for _ in range(6)]
        resolver = nominal.resolver
        noisy = replace(
            resolver,
            noise_rev=resolver.noise_rev * factors[0],
            velocity_noise_rps=resolver.velocity_noise_rps * factors[1],
        )
        if number % 2:
            bits = int(rng.integers(*ENCODER_BITS, endpoint=True))
            noisy = replace(noisy, bits=bits, noise_rev=0.0, tracking_hz=ENCODER_TRACKING_HZ)
        plant = replace(
            nominal,
            seed=number + 1,
            resolver=noisy,
            inertia_kg_m2=nominal.inertia_kg_m2 * factors[2],
            torque_constant_nm_per_a=nominal.torque_constant_nm_per_a * factors[3],
            delay_s=nominal.delay_s * factors[4],
            current_noise_a=nominal.current_noise_a * factors[5],
            current_bandwidth_hz=5000.0 if nominal.delay_s * factors[4] < 0.0022 else nominal.current_bandwidth_hz,
            friction=_friction(law, nominal.friction, rng, WIDE_SPREAD),
            effects=tuple(_effect(name, rng) for name in names),
        )
        if number % ELASTIC_EVERY == 0:
            others = tuple(effect for effect in plant.effects if effect.name != ELASTICITY)
            plant = replace(plant, effects=(_elastic_load(rng), *others))
            names = tuple(effect.name for effect in plant.effects)
        if not plant.errors():
            return RandomAxis(number, plant, law, names)
    raise ValueError(f"axis {number}: a hundred draws gave no drive; the last one: {plant.errors()[0]}")


def _elastic_load(rng: np.random.Generator) -> EffectConfig:
    def evenly_in_logarithm(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    values = {
        "load_share": float(rng.uniform(*ELASTIC_SHARE)),
        "frequency_hz": evenly_in_logarithm(*ELASTIC_HZ),
        "damping": evenly_in_logarithm(*ELASTIC_DAMPING),
    }
    return EffectConfig(ELASTICITY, values)


def _factor(rng: np.random.Generator, spread: float = SPREAD) -> float:
    return float(1.0 + spread * rng.uniform(-1.0, 1.0))


def _effect_names(number: int, rng: np.random.Generator) -> tuple[str, ...]:
    every = list(EFFECTS)
    own = every[number % len(every)]
    others = rng.choice([name for name in every if name != own], int(rng.integers(0, MORE_EFFECTS + 1)), replace=False)
    return (own, *(str(name) for name in others))


def _effect(name: str, rng: np.random.Generator) -> EffectConfig:
    """The effect with its strengths drawn, and its phases; what else it has stays at its default."""
    values = {}
    for p in EFFECTS[name].parameters:
        if p.strength:
            values[p.name] = float(np.clip(p.default * rng.uniform(0.0, STRONGEST), p.low, p.high))
        elif p.name.endswith("phase_rev"):
            values[p.name] = float(rng.uniform(0.0, 1.0))
    return EffectConfig(name, values)


def _fast_enough(resolver: ResolverConfig, delay_s: float) -> ResolverConfig:
    """A drive with little delay has a fast tracking loop."""
    return replace(resolver, tracking_hz=2000.0 if delay_s < 0.0022 else resolver.tracking_hz)


def _friction(law: str, nominal: PlantFriction, rng: np.random.Generator, spread: float = SPREAD) -> PlantFriction:
    level, rise, velocity, stiffness, memory, viscous = (_factor(rng, spread) for _ in range(6))
    coulomb_nm, viscous_nm_per_rps = 0.025 * level, 0.003 * viscous
    if law == "2SEP":
        single = replace(nominal.single, viscous_nm_per_rps=viscous_nm_per_rps)
        scaled = replace(nominal, kind="single_2sep", single=single)
        return scaled.scaled(level, rise, velocity, stiffness, memory)
    if law == "five surfaces":
        surfaces = tuple(replace(s, viscous_nm_per_rps=viscous * s.viscous_nm_per_rps) for s in nominal.surfaces)
        return replace(nominal, surfaces=surfaces).scaled(level, rise, velocity, stiffness, memory)
    # single contacts: without elastic share a contact creeps at any torque (LuGre), without rise it has no Stribeck
    # curve (Dahl)
    shapes = {
        "LuGre": (1.0 + 1.7 * rise, 2.0, 20.0, 0.0),
        "Dahl": (1.0, 1.0, 12.0, 0.0),
        "stiff contact with high stiction": (1.0 + 2.5 * rise, 1.0, 60.0, 0.5),
    }
    ratio, exponent, contact_nm_per_rev, elastic_share = shapes[law]
    surface = Surface(
        law, coulomb_nm, coulomb_nm * ratio, viscous_nm_per_rps, 0.733 * velocity, contact_nm_per_rev * stiffness,
        0.005 * memory, stribeck_exponent=exponent, elastic_share=elastic_share,
    )  # fmt: skip
    return replace(nominal, kind="five_surfaces", surfaces=(surface,))
