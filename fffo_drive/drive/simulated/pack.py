"""From the configuration of a simulated drive to the arrays of its kernels."""

from __future__ import annotations

import math

import numpy as np

from ...jit.by_address import vectors_address
from ...units import TWO_PI, counts_per_rev, inertia_nm_s2_per_rev
from . import friction
from . import state as at
from .effects import slots
from .effects.registry import EFFECTS
from .noise import RANDOM_WORDS, seed_words
from .parameters import PlantConfig, delay_budget
from .state import STEP_S, Floats, Integers, PlantParameters, PlantState
from .surfaces import KINDS, PlantFriction, StribeckLevel

FRICTION_KINDS = dict(
    zip(KINDS, (friction.FIVE_SURFACES, friction.SINGLE_2SEP, friction.LUGRE, friction.MAXWELL_SLIP), strict=True)
)


def plant_parameters(config: PlantConfig) -> PlantParameters:
    """The plant's constants; compiles the effects that are present. Raises PlantConfigError."""
    config.validate()
    prepared = config.prepared()
    addresses, effect_parameters, first = _effects(config)
    whole, fraction = _transport(prepared)
    return PlantParameters(
        numbers=_numbers(prepared, fraction),
        integers=np.array([_friction_kind(prepared.friction), whole, *first], np.int64),
        friction=_friction_table(prepared.friction),
        effects=addresses,
        effect_parameters=effect_parameters,
    )


def new_state(config: PlantConfig, seed: int | None = None) -> PlantState:
    """The plant at power-on: at rest, contacts unloaded. `seed` replaces the configured one."""
    whole, _ = _transport(config.prepared())
    values = np.zeros(at.N_VALUES)
    values[at.ANGLE_REV] = values[at.TRACKED_REV] = config.initial_angle_rev
    words = np.zeros(at.N_WORDS, np.int64)
    words[:RANDOM_WORDS] = seed_words(config.seed if seed is None else seed)
    contacts = np.zeros((len(_friction_table(config.friction)), friction.STATE_COLUMNS))
    if config.friction.kind == "five_surfaces":
        contacts[:, friction.STICTION] = 1.0
    return PlantState(
        values=values,
        words=words,
        friction=contacts,
        delay_line=np.zeros(whole + 2),
        signals=_signals(config),
        effect_memory=np.zeros((len(_kernels(config)), slots.MEMORY_SLOTS)),
    )


def _friction_kind(config: PlantFriction) -> int:
    return FRICTION_KINDS[config.kind]


def _friction_table(config: PlantFriction) -> Floats:
    """Rows of parameters at the motor shaft: torque over ratio, stiffness and viscosity over its square."""
    if config.kind == "single_2sep":
        return _rows(
            config.single, [(1.0, config.single.stiffness_per_rev)], memory=config.single.attraction_nm_per_rev
        )
    if config.kind == "lugre":
        one = config.lugre
        return _rows(one, [(1.0, one.stiffness_nm_per_rev)], damping=one.damping_nm_per_rps)
    if config.kind == "maxwell_slip":
        parts = [(element.share, element.stiffness_nm_per_rev) for element in config.maxwell_slip.elements]
        return _rows(config.maxwell_slip, parts, memory=config.maxwell_slip.attraction_nm_per_s)
    rows = [
        (
            s.coulomb_nm / s.ratio,
            (s.stiction_nm - s.coulomb_nm) / s.ratio,
            s.viscous_nm_per_rps / (s.ratio * s.ratio),
            1.0 / (s.stribeck_rps * s.ratio),
            s.stribeck_exponent,
            s.stiffness_nm_per_rev / (s.ratio * s.ratio),
            s.elastic_share,
            1.0 / (s.memory_rev * s.ratio),
        )
        for s in config.surfaces
    ]
    return np.array(rows).reshape(len(rows), friction.TABLE_COLUMNS)


def _rows(
    one: StribeckLevel,
    parts: list[tuple[float, float]],
    damping: float = 0.0,
    memory: float = 0.0,
) -> Floats:
    """Rows of contacts in parallel, each with its share of the level and its stiffness, (parts, TABLE_COLUMNS)."""
    return np.array(
        [
            (
                share * one.coulomb_nm,
                share * (one.stiction_nm - one.coulomb_nm),
                share * one.viscous_nm_per_rps,
                1.0 / one.stribeck_rps,
                one.stribeck_exponent,
                stiffness,
                damping,
                share * memory,
            )
            for share, stiffness in parts
        ]
    )


def _transport(config: PlantConfig) -> tuple[int, float]:
    """Transport delay in whole sub-steps, and the fraction beyond them."""
    substeps = max(0.0, delay_budget(config).transport_s + config.extra_delay_s) / STEP_S
    whole = math.floor(substeps)
    return whole, substeps - whole


def _numbers(config: PlantConfig, transport_fraction: float) -> Floats:
    numbers = np.zeros(at.N_NUMBERS)
    inertia = inertia_nm_s2_per_rev(config.inertia_kg_m2) * config.motor_inertia_share
    numbers[at.SPEED_PER_TORQUE] = STEP_S / inertia
    numbers[at.TORQUE_CONSTANT] = config.torque_constant_nm_per_a
    numbers[at.PEAK_CURRENT_A] = config.peak_current_a
    numbers[at.DC_LINK_V] = config.dc_link_v
    numbers[at.RESISTANCE_OHM] = config.resistance_ohm
    numbers[at.BACK_EMF] = TWO_PI * config.torque_constant_nm_per_a  # Kt = Ke in SI units, and w is in rev/s
    kept = math.exp(-STEP_S / config.electrical_time_constant_s)
    numbers[at.CURRENT_KEPT] = kept
    numbers[at.CURRENT_PER_V] = (1.0 - kept) / config.resistance_ohm
    numbers[at.V_PER_CURRENT] = config.resistance_ohm / (1.0 - kept * kept)
    numbers[at.CURRENT_APPROACH] = 1.0 - math.exp(-2.0 * TWO_PI * config.current_bandwidth_hz * STEP_S)
    numbers[at.TRANSPORT_FRACTION] = transport_fraction
    numbers[at.CURRENT_NOISE_A] = config.current_noise_a
    _put_resolver(numbers, config)
    numbers[at.ROUGHNESS_KEPT] = math.exp(-TWO_PI * config.roughness_hz * STEP_S)
    numbers[at.ROUGHNESS_NM] = config.roughness_nm * math.sqrt(1.0 - numbers[at.ROUGHNESS_KEPT] ** 2)
    thermal = config.thermal
    numbers[at.WARMING_K_PER_W] = thermal.k_per_w * STEP_S / thermal.time_constant_s
    numbers[at.COOLING] = STEP_S / thermal.time_constant_s
    numbers[at.VISCOUS_PER_K] = thermal.viscous_per_k
    numbers[at.COULOMB_PER_K] = thermal.coulomb_per_k
    numbers[at.OFFSET_NM_PER_K] = thermal.offset_nm_per_k
    return numbers


def _put_resolver(numbers: Floats, config: PlantConfig) -> None:
    r = config.resolver
    angular = TWO_PI * r.tracking_hz
    numbers[at.COUNTS_PER_REV] = counts_per_rev(r.bits)
    numbers[at.REV_PER_COUNT] = 1.0 / counts_per_rev(r.bits)
    numbers[at.TRACKING_POSITION] = 2.0 * r.tracking_damping * angular * STEP_S
    numbers[at.TRACKING_VELOCITY] = angular * angular * STEP_S
    numbers[at.RESOLVER_NOISE_REV] = r.noise_rev
    numbers[at.VELOCITY_NOISE_RPS] = r.velocity_noise_rps
    numbers[at.VELOCITY_LSB_RPS] = r.velocity_lsb_rps


def _kernels(config: PlantConfig) -> list[tuple[str, dict[str, float]]]:
    """Effects that run in the plant, in the order of their stages; within a stage as configured."""
    running = [(name, values) for name, values in config.present_effects() if EFFECTS[name].kernel is not None]
    return sorted(running, key=lambda item: EFFECTS[item[0]].stage)


def _effects(config: PlantConfig) -> tuple[Integers, Floats, list[int]]:
    running = _kernels(config)
    parameters = np.zeros((len(running), slots.MAX_PARAMETERS))
    addresses = np.zeros(len(running), np.int64)
    for k, (name, values) in enumerate(running):
        kernel = EFFECTS[name].kernel
        assert kernel is not None
        addresses[k] = vectors_address(kernel)
        parameters[k, : len(values)] = list(values.values())
    stages = [EFFECTS[name].stage for name, _ in running]
    first = [sum(stage < boundary for stage in stages) for boundary in range(slots.N_STAGES + 1)]
    return addresses, parameters, first


def _signals(config: PlantConfig) -> Floats:
    signals = np.zeros(slots.N_SLOTS)
    signals[slots.STEP_S] = STEP_S
    signals[slots.GEAR_RATIO] = config.gear_ratio
    signals[slots.RATED_CURRENT_A] = config.rated_current_a
    signals[slots.TORQUE_CONSTANT_NM_PER_A] = config.torque_constant_nm_per_a
    signals[slots.INERTIA_NM_S2_PER_REV] = inertia_nm_s2_per_rev(config.inertia_kg_m2)
    signals[slots.COULOMB_NM] = config.friction.coulomb_nm or 1.0
    return signals
