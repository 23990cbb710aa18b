"""A small simulated machine that shares nothing with the controller's model: Dahl friction, an encoder, a warm bearing.

    2 pi J dv/dt = T - z (Fc + share |T|) h(v) level(t) - B v - load(position, t),  dz/dt = (v - |v| z) / presliding

z is the bristle, -1 to 1; h = 1 + (Fs / Fc - 1) exp(-(v / vs)^2); T follows the command late and through a lag. The
load is what the cases are about (a constant, waves of the angle, pushes) and a coloured torque that no model explains.
Every number of a case is in its `Machine`, all noise comes from a seed: records are the same on every call.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import signal

from fffo_drive.identification.dataset import Record
from fffo_drive.jit import njit

TORQUE, VELOCITY, POSITION = 0, 1, 2  # what a reference is: A, rps, rev
SUBSTEP_S = 5e-5
SLOW_S = 8.0  # correlation of the wandering share of the Coulomb friction


@dataclass(frozen=True)
class Wave:
    """A torque over the angle: `order` periods a turn; times the friction's direction where `friction` is set."""

    order: float
    size_nm: float
    phase_rev: float = 0.0  # of a period
    friction: bool = False


@dataclass(frozen=True)
class Machine:
    """Everything that is true of a case, motor side."""

    inertia_kg_m2: float
    coulomb_nm: float
    viscous_nm_per_rps: float = 0.0
    torque_constant_nm_per_a: float = 0.1
    static_nm: float = 0.0  # what friction has more at rest
    stribeck_rps: float = 0.5
    presliding_rev: float = 2e-4
    offset_nm: float = 0.0  # taken from the torque
    waves: tuple[Wave, ...] = ()
    load_share: float = 0.0  # friction per motor torque
    cable_nm_per_rev: float = 0.0
    pulse_nm: float = 0.0
    pulse_every_s: float = 1.0
    pulse_s: float = 0.05
    warming_share: float = 0.0  # Coulomb friction falls by this share ...
    warming_s: float = 60.0  # ... with this time constant
    wander_share: float = 0.0  # and wanders by this one, sd
    rough_nm: float = 0.0  # coloured torque, sd ...
    rough_hz: float = 2.0  # ... and its bandwidth
    delay_s: float = 0.002
    current_lag_s: float = 0.0004
    current_noise_a: float = 0.0  # ripple of the current, sd: acts on the torque and is not in the command
    lsb_rev: float = 2.0**-17
    encoder_noise_rev: float = 0.0
    eccentricity_rev: float = 0.0
    velocity_lag_s: float = 0.0015
    current_lsb_a: float = 1e-3
    current_limit_a: float = 50.0
    anti_cogging_share: float = 0.0  # of the waves, that the drive itself adds to its command by the measured angle


@njit
def _advance(p, waves, reference, mode, gain, second, random, out):
    """One run. `random` (4, n): coloured torque, Coulomb level, current, encoder; `out` (4, n): command, position,
    velocity estimate, true velocity."""
    (inertia, coulomb, viscous, kt, static, stribeck, presliding, offset, load_share, cable, pulse, every, wide, delay,
     lag, lsb, eccentric, velocity_lag, period, current_lsb, limit, x, begin, anti_cogging) = p  # fmt: skip
    steps = round(period / SUBSTEP_S)
    late = int(delay / period)
    fresh = round((delay - late * period) / SUBSTEP_S)
    v = z = current = integral = estimate = 0.0
    start = x
    before = math.floor(x / lsb) * lsb
    for k in range(reference.size):
        seen = x + eccentric * math.sin(2.0 * math.pi * x) + random[3, k]
        counted = math.floor(seen / lsb) * lsb
        estimate += ((counted - before) / period - estimate) * (1.0 - math.exp(-period / velocity_lag))
        before = counted
        if mode == VELOCITY:
            error = reference[k] - estimate
            integral += second * error * period
            command = gain * error + integral
        elif mode == POSITION:
            command = gain * (reference[k] - counted) - second * estimate
        else:
            command = reference[k]
        for w in range(waves.shape[0]):
            command += anti_cogging / kt * waves[w, 1] * math.cos(2.0 * math.pi * (waves[w, 0] * counted - waves[w, 2]))
        command = min(max(command, -limit), limit)
        command = math.floor(command / current_lsb + 0.5) * current_lsb
        out[0, k] = command
        out[1, k] = counted
        out[2, k] = estimate
        out[3, k] = v
        for s in range(steps):
            at = k - late if s >= fresh else k - late - 1
            demand = out[0, at] if at >= 0 else 0.0
            current += (demand - current) * (1.0 - math.exp(-SUBSTEP_S / lag))
            torque = kt * (current + random[2, k])
            load = offset + random[0, k] * abs(v) / (abs(v) + 0.2) + cable * (x - start)
            turn = 1.0 + load_share * abs(torque) / coulomb
            for w in range(waves.shape[0]):
                wave = waves[w, 1] * math.cos(2.0 * math.pi * (waves[w, 0] * x - waves[w, 2]))
                if waves[w, 3] > 0.0:
                    turn += wave / coulomb
                else:
                    load += wave
            clock = (begin + k * period) / every
            load -= pulse * wide / every  # no constant torque is left of the pushes
            if (clock - math.floor(clock)) * every < wide:
                load += pulse
            way = 1.0 if v > 0.0 else -1.0
            z = way + (z - way) * math.exp(-abs(v) * SUBSTEP_S / presliding)
            level = random[1, k] * turn * (coulomb + static * math.exp(-((v / stribeck) ** 2)))
            v += SUBSTEP_S * (torque - z * level - viscous * v - load) / (2.0 * math.pi * inertia)
            x += SUBSTEP_S * v


def coloured(random, n, bandwidth_hz, period_s):
    """Noise of unit variance through a first-order low-pass, (n,)."""
    kept = math.exp(-2.0 * math.pi * bandwidth_hz * period_s)
    white = random.standard_normal(n + 1) * math.sqrt(1.0 - kept * kept)
    white[0] /= math.sqrt(1.0 - kept * kept)
    return signal.lfilter([1.0], [1.0, -kept], white)[1:]


def run(
    machine, reference, mode=VELOCITY, gains=(1.0, 10.0), period_s=0.001, name="run", begin_s=0.0, start_rev=0.0, seed=1
):
    """The record of one run. `gains`: A/rps and A/rev (VELOCITY), A/rev and A/rps (POSITION)."""
    m, n = machine, reference.size
    random = np.random.default_rng(seed)
    time_s = begin_s + np.arange(n) * period_s
    level = 1.0 + m.warming_share * (np.exp(-time_s / m.warming_s) - 1.0)
    level += m.wander_share * coloured(random, n, 1.0 / (2.0 * math.pi * SLOW_S), period_s)
    noise = np.stack([
        m.rough_nm * coloured(random, n, m.rough_hz, period_s), level,
        m.current_noise_a * random.standard_normal(n), m.encoder_noise_rev * random.standard_normal(n),
    ])  # fmt: skip
    numbers = (
        m.inertia_kg_m2, m.coulomb_nm, m.viscous_nm_per_rps, m.torque_constant_nm_per_a, m.static_nm, m.stribeck_rps,
        m.presliding_rev, m.offset_nm, m.load_share, m.cable_nm_per_rev, m.pulse_nm, m.pulse_every_s, m.pulse_s,
        m.delay_s, m.current_lag_s, m.lsb_rev, m.eccentricity_rev, m.velocity_lag_s, period_s, m.current_lsb_a,
        m.current_limit_a, start_rev, begin_s, m.anti_cogging_share,
    )  # fmt: skip
    waves = np.array([(w.order, w.size_nm, w.phase_rev, float(w.friction)) for w in m.waves]).reshape(-1, 4)
    out = np.zeros((4, n))
    _advance(tuple(map(float, numbers)), waves, np.ascontiguousarray(reference, dtype=float), mode, *gains, noise, out)
    closed = mode == VELOCITY
    return Record(
        name=name, path=Path(name), period_s=period_s, torque_constant_nm_per_a=m.torque_constant_nm_per_a,
        current_a=out[0].copy(), position_rev=out[1].copy(), velocity_rps=out[2].copy(),
        reference_rps=np.asarray(reference, dtype=float).copy() if closed else None,
        lsb_rev=m.lsb_rev, breaks=(), digest="", begin_s=begin_s,
    )  # fmt: skip


def lines(period_s, *corners):
    """Straight lines from zero through (duration in s, level at its end): (n,)."""
    times = np.cumsum([0.0, *(duration for duration, _ in corners)])
    levels = [0.0, *(level for _, level in corners)]
    return np.interp(np.arange(round(times[-1] / period_s)) * period_s, times, levels)


def sines(seed, duration_s, period_s, peak, low_hz, high_hz, number=12, slope=-0.6):
    """A multisine of this peak with drawn phases, faded in and out over half a second: (n,)."""
    random = np.random.default_rng(seed)
    time_s = np.arange(round(duration_s / period_s)) * period_s
    frequencies = np.geomspace(low_hz, high_hz, number)
    wave = sum(f**slope * np.sin(2.0 * np.pi * (f * time_s + random.uniform())) for f in frequencies)
    fade = np.clip(np.minimum(time_s, time_s[-1] - time_s) / 0.5, 0.0, 1.0)
    return peak * wave / np.abs(wave).max() * fade
