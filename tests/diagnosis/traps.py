"""Stand-ins for measured machines on which a diagnosis once said something false: each with the trap that misled it.

A case is a few runs of a simulated machine (`machine.py`), what is declared about it, and what is true. Rest that no
law explains (a coloured torque, friction that wanders, ripple of the current) is at the level of the real machines.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from diagnosis.machine import POSITION, TORQUE, VELOCITY, Machine, Wave, lines, run, sines
from identification.rig import random_plant, record

from fffo_drive.control.reference import Profile, paper_reference
from fffo_drive.drive.simulated.parameters import EffectConfig
from fffo_drive.identification.dataset import Record
from fffo_drive.identification.excitation import identification_sequence, separating_recipe
from fffo_drive.identification.facts import DriveFacts

MS = 0.001
WAVES = frozenset({"cogging", "torque_ripple", "friction_ripple"})


@dataclass(frozen=True)
class Trap:
    """Runs of a machine and the truth about it."""

    name: str
    fit: list[Record]
    held_out: list[Record]
    facts: DriveFacts
    inertia_kg_m2: float
    inertia_within: float  # share by which a sound fit may miss it; infinite: these runs do not tell it
    first: frozenset[str]  # names that the first finding may have; empty: nothing may be named
    orders: tuple[float, ...]  # of the waves that a diagnosis has to find, per motor turn
    offset_nm: float  # constant torque, taken from the motor's
    truth: str  # for people


def disc() -> Trap:
    """A 400 W servo with a disc: a constant torque, and commands that a slow lag can swallow.

    The command is a torque without a mean and without anything slow: a lag of half a second takes all of it away, and
    what is left of the axis is small beside its own torque.
    """
    machine = Machine(
        inertia_kg_m2=1.94e-4, coulomb_nm=0.0306, viscous_nm_per_rps=6e-5, torque_constant_nm_per_a=0.45,
        static_nm=0.001, offset_nm=-0.0039, waves=(Wave(1.0, 3e-4, 0.2), Wave(10.0, 3e-4, 0.6)), warming_share=0.06,
        warming_s=60.0, wander_share=0.03, rough_nm=0.0008, rough_hz=3.0, current_noise_a=0.004, presliding_rev=1e-4,
        encoder_noise_rev=2e-6, eccentricity_rev=2e-5, current_lsb_a=0.0027, current_limit_a=8.0,
    )  # fmt: skip
    peaks_nm = (0.2, 0.18, 0.22, 0.19, 0.21, 0.2)
    references = {
        f"sines-{k}": sines(10 + k, 12.0, MS, peak / machine.torque_constant_nm_per_a, 2.0, 9.0, slope=0.0)
        for k, peak in enumerate(peaks_nm, 1)
    }
    runs = _one_after_another(machine, references, (0.0, 0.0), seed=100, mode=TORQUE)
    facts = DriveFacts(torque_constant_nm_per_a=0.45, rated_current_a=2.7, resolver_bits=17, sample_rate_hz=1000.0)
    return Trap(
        "disc", runs[:4], runs[4:], facts, machine.inertia_kg_m2, 0.05, frozenset({"torque_offset"}), (),
        machine.offset_nm,
        "constant torque -3.9 mNm first (taken from the motor torque; the sign of the law). J 1.94e-4 kg m2, Coulomb "
        "30.6 mNm, falls by 6 % over the log and wanders by 3 %; waves of order 1 and 10, 0.3 mNm each. No lag.",
    )  # fmt: skip


def coupled() -> Trap:
    """A coupled pair of small servos under torque steps: a constant torque beside a travel of a thousand turns."""
    return _torque_steps("coupled", 0.0092, frozenset({"torque_offset"}))


def oneway() -> Trap:
    """The same without the constant torque: direction and travel are one thing, and nothing is to be named."""
    return _torque_steps("oneway", 0.0, frozenset())


def _torque_steps(name: str, offset_nm: float, first: frozenset[str]) -> Trap:
    machine = Machine(
        inertia_kg_m2=3.2e-5, coulomb_nm=0.018, viscous_nm_per_rps=7e-4, torque_constant_nm_per_a=0.18,
        static_nm=0.002, offset_nm=offset_nm, wander_share=0.1, rough_nm=0.0045, rough_hz=0.3, current_noise_a=0.01,
        presliding_rev=3e-4, encoder_noise_rev=5e-6, current_lsb_a=0.0017, current_limit_a=2.0,
    )  # fmt: skip
    random = np.random.default_rng(21)
    references = {}
    for number in range(8):
        way = 1.0 if number % 2 == 0 else -1.0
        parts = [np.zeros(200)]
        while sum(map(len, parts)) < 6000:
            parts.append(np.full(int(random.integers(250, 700)), random.uniform(0.035, 0.11)))
        torque = way * np.concatenate(parts)[:6000] + offset_nm
        references[f"steps-{number + 1}"] = torque / machine.torque_constant_nm_per_a
    runs = _one_after_another(machine, references, (0.0, 0.0), seed=200, mode=TORQUE)
    facts = DriveFacts(torque_constant_nm_per_a=0.18, rated_current_a=1.7, resolver_bits=17, sample_rate_hz=1000.0)
    what = "constant torque 9.2 mNm first and nothing else" if first else "NOTHING; direction and travel are one thing"
    return Trap(
        name, runs[:6], runs[6:], facts, machine.inertia_kg_m2, 0.1, first, (), offset_nm,
        f"{what}. J 3.2e-5 kg m2, Coulomb 18 mNm, viscous 0.7 mNm/rps. Each run turns one way, the position begins at "
        "0 in each: some 400 turns forwards in the odd runs, as many backwards in the even ones.",
    )  # fmt: skip


def wrist() -> Trap:
    """A robot's wrist joint: waves of orders 3 and 1 of the motor, short runs of which several turn one way."""
    machine = Machine(
        inertia_kg_m2=1.6e-5, coulomb_nm=0.024, viscous_nm_per_rps=4e-4, torque_constant_nm_per_a=0.12,
        static_nm=0.004, stribeck_rps=1.0, waves=(Wave(3.0, 0.0058, 0.3), Wave(1.0, 0.0042, 0.75), Wave(2.0, 5e-4)),
        wander_share=0.05, rough_nm=0.0034, rough_hz=2.0, current_noise_a=0.02, lsb_rev=2.0**-15,
        encoder_noise_rev=1e-5, cable_nm_per_rev=2e-5, presliding_rev=1e-3, current_lsb_a=0.001, current_limit_a=4.0,
    )  # fmt: skip

    def steps(*levels: float) -> np.ndarray:
        return lines(MS, (0.2, 0.0), *(c for v in levels for c in ((0.12, v), (0.5, v))), (0.15, 0.0), (0.2, 0.0))

    references = {
        "speed-04": steps(2.0, 4.0, 3.0, 5.0, 2.0, 4.0),
        "speed-10": steps(-6.0, -10.0, -5.0, -8.0, -11.0, -6.0),
        "speed-20": steps(14.0, 20.0, 10.0, 18.0, 12.0, 20.0),
        "speed-27": steps(-18.0, -27.0, -15.0, -24.0, -12.0, -20.0),
        "both-08": steps(8.0, -8.0, 4.0, -6.0, 8.0, -4.0),
        "both-16": steps(-16.0, 12.0, -9.0, 16.0, -14.0, 7.0),
        "speed-15": steps(9.0, 15.0, 7.0, 13.0, 5.0, 11.0),
        "both-12": steps(12.0, -7.0, 10.0, -12.0, 5.0, -9.0),
    }
    runs = _one_after_another(machine, references, (0.12, 1.2), seed=300, absolute=True)
    facts = DriveFacts(
        torque_constant_nm_per_a=0.12, rated_current_a=1.0, gear_ratio=100.0, resolver_bits=15, sample_rate_hz=1000.0,
        absolute_angle=True,
    )  # fmt: skip
    return Trap(
        "wrist", runs[:6], runs[6:], facts, machine.inertia_kg_m2, 0.05, WAVES, (3.0, 1.0), 0.0,
        "waves of the motor's turn: order 3, 5.8 mNm, and order 1, 4.2 mNm, in the torque (cogging); order 2, 0.5 mNm. "
        "J 1.6e-5 kg m2, Coulomb 24 mNm. No limit of the voltage.",
    )  # fmt: skip


def payload() -> Trap:
    """Another payload in the middle of the log: J grows by 34 % and nothing else changes."""
    machine = Machine(
        inertia_kg_m2=1.2e-4, coulomb_nm=0.022, viscous_nm_per_rps=3e-4, torque_constant_nm_per_a=0.2,
        static_nm=0.003, rough_nm=0.0015, rough_hz=4.0, wander_share=0.02, current_noise_a=0.005, current_lsb_a=0.002,
        encoder_noise_rev=2e-6, current_limit_a=6.0,
    )  # fmt: skip
    heavy = replace(machine, inertia_kg_m2=1.34 * machine.inertia_kg_m2)
    references = {f"run-{k}": sines(40 + k, 12.0, MS, 11.0, 0.3, 5.0) for k in range(1, 7)}
    before = _one_after_another(machine, references, (0.7, 5.0), seed=400)
    after = _one_after_another(heavy, references, (0.7, 5.0), seed=450)
    runs = [*before[:2], *after[2:4], before[4], after[5]]
    facts = DriveFacts(torque_constant_nm_per_a=0.2, rated_current_a=2.0, resolver_bits=17, sample_rate_hz=1000.0)
    return Trap(
        "payload", runs[:4], runs[4:], facts, machine.inertia_kg_m2, 0.34, frozenset(), (), 0.0,
        "J 1.2e-4 kg m2 in run-1 and run-2 (and held-out run-5), 34 % more in run-3 and run-4 (and run-6); nothing "
        "else. The runs contradict each other; no law explains it.",
    )  # fmt: skip


def clock() -> Trap:
    """A push every 0.73 s by a clock of its own, too short to be a sine."""
    machine = Machine(
        inertia_kg_m2=1.0e-4, coulomb_nm=0.025, viscous_nm_per_rps=4e-4, torque_constant_nm_per_a=0.2,
        static_nm=0.003, pulse_nm=0.021, pulse_every_s=0.73, pulse_s=0.04, rough_nm=0.001, rough_hz=4.0,
        wander_share=0.015, current_noise_a=0.005, current_lsb_a=0.002, encoder_noise_rev=2e-6, current_limit_a=6.0,
    )  # fmt: skip
    references = {f"run-{k}": sines(60 + k, 14.0, MS, 10.0, 0.2, 4.0) for k in range(1, 5)}
    runs = _one_after_another(machine, references, (0.7, 5.0), seed=500)
    facts = DriveFacts(torque_constant_nm_per_a=0.2, rated_current_a=2.0, resolver_bits=17, sample_rate_hz=1000.0)
    return Trap(
        "clock", runs[:3], runs[3:], facts, machine.inertia_kg_m2, 0.05, frozenset(), (), 0.0,
        "a push of 21 mNm for 40 ms every 0.73 s on the log's clock, whatever the axis does. Its harmonics (k / 0.73 s)"
        " are no lie; beside one of them most is left. J 1.0e-4 kg m2, Coulomb 25 mNm.",
    )  # fmt: skip


def waves_slow() -> Trap:
    """A gimbal motor on a speed loop at about one turn a second, one way: cogging of orders 72 and 18.

    The drive has an anti-cogging of its own: at 72 Hz the loop would leave the wave to the inertia, and the current
    would not show it.
    """
    machine = Machine(
        inertia_kg_m2=2.5e-5, coulomb_nm=0.0011, viscous_nm_per_rps=1e-4, torque_constant_nm_per_a=0.025,
        static_nm=2e-4, waves=(Wave(72.0, 0.0040, 0.1), Wave(18.0, 0.0014, 0.4), Wave(12.0, 4e-4, 0.8)),
        rough_nm=8e-4, rough_hz=4.0, current_noise_a=0.01, lsb_rev=2.0**-12, encoder_noise_rev=6e-5,
        velocity_lag_s=0.004, current_lsb_a=0.001, current_limit_a=5.0, presliding_rev=2e-3, delay_s=0.001,
        anti_cogging_share=0.9,
    )  # fmt: skip
    references = {}
    for number in range(4):
        speed = sines(80 + number, 10.0, MS, 0.35, 0.3, 3.0)
        references[f"turning-{number + 1}"] = speed + lines(MS, (0.3, 1.0), (9.4, 1.0), (0.3, 0.0))
    runs = _one_after_another(machine, references, (0.12, 2.5), seed=600, absolute=True)
    facts = DriveFacts(
        torque_constant_nm_per_a=0.025, rated_current_a=3.0, resolver_bits=12, sample_rate_hz=1000.0, slots=18,
        pole_pairs=12, absolute_angle=True,
    )  # fmt: skip
    return Trap(
        "waves_slow", runs[:3], runs[3:], facts, machine.inertia_kg_m2, np.inf, WAVES, (72.0, 18.0), 0.0,
        "cogging of order 72, 4.0 mNm, then 18, 1.4 mNm, then 12, 0.4 mNm. J 2.5e-5 kg m2, hardly set by these runs; "
        "one way only: constant torque and Coulomb friction are one thing.",
    )  # fmt: skip


def waves_fast() -> Trap:
    """An axis of the blind kind with cogging of order 24, a period of which passes in 3 ms at top speed."""
    plant = replace(random_plant(5), roughness_nm=4e-4)
    size_nm = 0.15 * plant.friction.single.coulomb_nm
    wave = EffectConfig("cogging", {"amplitude_nm": size_nm, "order": 24.0, "phase_rev": 0.01})
    plant = replace(plant, effects=(wave,))
    period_s = 0.0005
    profiles: dict[str, Profile] = {
        "identify": identification_sequence(16.0, period_s, 0.4, 1.0, 0.05, 10.0),
        "track": paper_reference(16.0, period_s, 0.2, 15.0, 0.05, 10.0, 30, -0.8, 5),
        "recipe": separating_recipe(period_s, 10.0, 80.0, 1),
        "check": paper_reference(14.0, period_s, 0.2, 12.0, 0.05, 10.0, 30, -0.8, 6),
    }
    runs = [record(plant, profile, name) for name, profile in profiles.items()]
    facts = DriveFacts(
        torque_constant_nm_per_a=0.148, rated_current_a=8.3, gear_ratio=160.0, resolver_bits=15, sample_rate_hz=2000.0
    )
    return Trap(
        "waves_fast", runs[:3], runs[3:], facts, plant.inertia_kg_m2, 0.05, WAVES, (24.0,), 0.0,
        f"cogging of order 24, {1e3 * size_nm:.2f} mNm (15 % of the Coulomb friction).",
    )  # fmt: skip


def arm() -> Trap:
    """A servo with a pendulum, position loop, 200 Hz: gravity first, then friction that grows with the load."""
    machine = Machine(
        inertia_kg_m2=0.0062, coulomb_nm=0.035, viscous_nm_per_rps=0.12, torque_constant_nm_per_a=0.5,
        static_nm=0.006, stribeck_rps=0.05, presliding_rev=5e-4, waves=(Wave(1.0, 0.42, 0.25),), load_share=0.16,
        wander_share=0.05, rough_nm=0.012, rough_hz=0.7, current_noise_a=0.02, lsb_rev=2.0**-14, encoder_noise_rev=2e-5,
        cable_nm_per_rev=0.02, delay_s=0.005, current_lag_s=0.001, velocity_lag_s=0.01, current_lsb_a=0.001,
        current_limit_a=1.9,
    )  # fmt: skip
    period_s = 0.005
    references = {
        "swing-1": sines(91, 10.0, period_s, 0.24, 0.15, 1.2),
        "lift-1": lines(
            period_s, (1.0, 0.22), (1.0, 0.22), (1.5, -0.2), (0.8, -0.2), (0.5, 0.1), (0.8, 0.1), (2.0, 0.0)
        ),
        "swing-2": sines(92, 10.0, period_s, 0.18, 0.2, 2.0),
        "lift-2": lines(period_s, (0.6, -0.24), (0.8, -0.24), (0.7, 0.12), (0.8, 0.12), (1.6, -0.1), (2.5, 0.24)),
        "swing-3": sines(93, 10.0, period_s, 0.22, 0.2, 1.5),
        "lift-3": lines(period_s, (0.8, 0.2), (0.9, 0.2), (1.0, -0.15), (0.8, -0.15), (0.7, 0.24), (0.8, 0.24)),
    }
    runs = [
        run(machine, values, POSITION, (22.0, 0.25), period_s, name, 30.0 * k, 0.0, 700 + k)
        for k, (name, values) in enumerate(references.items())
    ]
    facts = DriveFacts(torque_constant_nm_per_a=0.5, resolver_bits=14, sample_rate_hz=200.0, absolute_angle=True)
    return Trap(
        "arm", runs[:4], runs[4:], facts, machine.inertia_kg_m2, 0.1, frozenset({"unbalance", "cogging"}), (1.0,), 0.0,
        "gravity first: 0.42 Nm times the sine of the angle (0 hangs down, a wave a turn of the shaft). Then friction "
        "grows by 0.16 Nm per Nm of motor torque. J 0.0062 kg m2, Coulomb 35 mNm, viscous 0.12 Nm/rps.",
    )  # fmt: skip


TRAPS: dict[str, Callable[[], Trap]] = {
    make.__name__: make
    for make in (disc, coupled, wrist, payload, oneway, clock, waves_slow, waves_fast, arm)
}  # fmt: skip


def _one_after_another(
    machine: Machine, references: dict[str, np.ndarray], gains: tuple[float, float], seed: int, mode: int = VELOCITY,
    absolute: bool = False,
) -> list[Record]:  # fmt: skip
    """The runs on one clock, 2 s between them; the position begins at 0 in each, or goes on where it is absolute."""
    records: list[Record] = []
    begin_s = start_rev = 0.0
    for number, (name, values) in enumerate(references.items()):
        made = run(machine, values, mode, gains, MS, name, begin_s, start_rev, seed + number)
        records.append(made)
        begin_s += made.duration_s + 2.0
        if absolute:
            start_rev = float(made.position_rev[-1])
    return records
