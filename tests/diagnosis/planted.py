"""Runs of the model itself with a torque planted in them: what the load takes, the command has more, a delay earlier.

The motion is that of the model without the load, so that the truth is exact and a run costs milliseconds.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import signal

from fffo_drive.diagnosis.diagnose import prepared
from fffo_drive.diagnosis.fitting import Data, Fitted
from fffo_drive.diagnosis.rows import make_filter
from fffo_drive.diagnosis.scenes import Effect
from fffo_drive.diagnosis.scored import base_of, settled
from fffo_drive.identification.dataset import Record
from fffo_drive.identification.facts import DriveFacts
from fffo_drive.identification.ladder import Ladder
from fffo_drive.least_squares import huber
from fffo_drive.model.axis import AxisConfig, AxisState, simulate
from fffo_drive.model.effects.registry import NAMES as LAWS
from fffo_drive.model.friction import OMEGA_CLIPPED, REST, FrictionConfig

Floats = npt.NDArray[np.float64]

PERIOD_S = 0.001
KT = 0.148
DELAY_S = 0.002  # whole samples: what is planted in the command acts without a rest
INERTIA = 9.4e-4  # Nm s2/rev
FRICTION = FrictionConfig(0.025, 0.04, 0.733, 1.07, 0.003, 778.0, 2.33, OMEGA_CLIPPED)
TRUTH = np.array([INERTIA, DELAY_S, 0.003, 0.025, 0.04, 0.733, 1.07, 778.0, 2.33, 0.0, 0.0])
FACTS = DriveFacts(
    torque_constant_nm_per_a=KT, rated_current_a=8.3, resolver_bits=15, sample_rate_hz=1000.0, absolute_angle=True
)
NOISE_NM = 1e-3  # coloured: what no law explains
NOISE_HZ = 20.0
LSB_REV = 2.0**-15
GAP_S = 2.0  # between runs


class Motion(NamedTuple):
    """What a planted load is made of, (n,) each, at the instants at which the command acts."""

    time_s: Floats  # on the clock of the log
    position_rev: Floats
    velocity_rps: Floats
    torque_nm: Floats  # of the motor without the load


Load = Callable[[Motion], Floats]


def nothing(motion: Motion) -> Floats:
    """No load."""
    return np.zeros(motion.time_s.size)


def current(seed: int, duration_s: float, peak_a: float, bias_a: float = 0.0) -> Floats:
    """A multisine of torque that turns the axis both ways, (n,)."""
    draw = np.random.default_rng(seed)
    time_s = np.arange(round(duration_s / PERIOD_S)) * PERIOD_S
    wave = sum(
        f**-0.3 * np.sin(2.0 * np.pi * (f * time_s + draw.uniform())) for f in (0.13, 0.31, 0.57, 1.1, 2.3, 4.7, 9.1)
    )
    fade = np.clip(np.minimum(time_s, time_s[-1] - time_s) / 0.5, 0.0, 1.0)
    return np.asarray((peak_a * wave / np.abs(wave).max() + bias_a) * fade)


def planted(
    load: Load = nothing, seed: int = 1, duration_s: float = 12.0, peak_a: float = 1.2, inertia: float = INERTIA,
    noise_nm: float = NOISE_NM, name: str = "run", begin_s: float = 0.0, bias_a: float = 0.0, lag_s: float = 0.0,
) -> Record:  # fmt: skip
    """A run whose motion is the model's, and whose command carries `load` as well.

    `lag_s`: the current follows its command through a lag of first order, as the measured current shows.
    """
    command = current(seed, duration_s, peak_a, bias_a)
    axis = AxisConfig(inertia, KT, DELAY_S, FRICTION)
    states, _ = simulate(axis, AxisState(0.0, 0.0, REST), command, PERIOD_S, 4)
    position = states[:, 1]
    draw = np.random.default_rng(1000 + seed)
    time_s = np.arange(command.size) * PERIOD_S
    # a held command acts from its sample plus the delay for one period: on average half a period later
    at_s = time_s + DELAY_S + 0.5 * PERIOD_S
    velocity = np.gradient(position, PERIOD_S)
    motion = Motion(
        begin_s + at_s, np.interp(at_s, time_s, position), np.interp(at_s, time_s, velocity), KT * command
    )  # fmt: skip
    noise = signal.sosfilt(signal.butter(1, NOISE_HZ, fs=1.0 / PERIOD_S, output="sos"), draw.normal(size=command.size))
    noise *= noise_nm / max(float(noise.std()), 1e-12)
    carried = command + (load(motion) + noise) / KT
    kept = np.exp(-PERIOD_S / lag_s) if lag_s else 0.0
    before = np.concatenate([[0.0], carried[:-1]])
    asked = (carried - kept * before) / (1.0 - kept)  # the lag makes `carried` of it
    measured = position + 2e-6 * draw.normal(size=position.size)
    counted = np.floor(measured / LSB_REV) * LSB_REV
    return Record(
        name=name, path=Path(name), period_s=PERIOD_S, torque_constant_nm_per_a=KT,
        current_a=asked, measured_current_a=carried if lag_s else None, position_rev=counted,
        velocity_rps=None, reference_rps=None, lsb_rev=LSB_REV, breaks=(), digest="", begin_s=begin_s,
    )  # fmt: skip


def runs(*loads: Load, seed: int = 1, **options: float) -> list[Record]:
    """Runs one after another on one clock, each with a load of its own."""
    found: list[Record] = []
    for k, load in enumerate(loads):
        begin_s = sum(record.duration_s + GAP_S for record in found)
        found.append(planted(load, seed=seed + k, name=f"run-{seed + k}", begin_s=begin_s, **options))
    return found


def based(records: list[Record], facts: DriveFacts = FACTS) -> tuple[Data, Fitted]:
    """Data with its levels of noise, and the base model fitted without effects."""
    data = started(records, facts)
    data, scored = settled(data, base_of(data))
    return data, scored.fitted


def started(records: list[Record], facts: DriveFacts = FACTS) -> Data:
    """Data as a search begins with them."""
    return begun(records, facts)[0]


def begun(
    records: list[Record], facts: DriveFacts = FACTS, without: frozenset[str] = frozenset()
) -> tuple[Data, Ladder]:
    """Data as a search begins with them, and the first rungs without some laws."""
    return prepared(records, facts, make_filter(records[0].period_s), without=without)


def effect(name: str, strengths: dict[str, float], **shapes: float) -> Effect:
    """An effect with one value of each strength."""
    return Effect(name, shapes, {key: np.array([value]) for key, value in strengths.items()})


def only(*names: str) -> frozenset[str]:
    """What a search leaves out that looks at these laws alone, free curves apart."""
    return frozenset(LAWS) - set(names)


def left(data: Data, fitted: Fitted, extra_nm: Floats) -> Fitted:
    """The same model with more of a residual, (m,)."""
    residual = fitted.residual_nm + extra_nm
    white = data.white(residual)
    return fitted._replace(residual_nm=residual, white=white, loss=float(huber(white).mean()))
