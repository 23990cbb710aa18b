"""Generated logs of other programs, with the truth behind each: what `import` has to read right or ask about.

Names in five languages and those of drives and robots' programs, units, rates, clocks, restarts, registers, columns
that are none of the signals, and headings that lie. Everything follows from one seed.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

TORQUE_CONSTANT_NM_PER_A = 0.05
INERTIA, COULOMB, STRIBECK, VISCOUS = 4e-3, 0.6, 0.85, 0.08  # A s2/rev, A, A, A/rps
SLIDING_RPS, SMOOTH_RPS = 0.4, 0.03
MOST_ROWS, LEAST_S, MOST_S = 9000, 8.0, 30.0
RATES_HZ = (100.0, 125.0, 200.0, 250.0, 400.0, 500.0, 800.0, 1000.0)
TOLERANCE = 0.03  # of a scale: the noise of the log is in it
ALIKE = 0.97  # correlation of what was read with the truth
MIDNIGHT = datetime.datetime(2026, 3, 1, 23, 59, 55, tzinfo=datetime.UTC)

TURN = {"rev": 1.0, "rad": 2.0 * np.pi, "deg": 360.0, "counts": 4096.0}
SPEED = {"rps": 1.0, "rpm": 60.0, "rad/s": 2.0 * np.pi, "deg/s": 360.0}
SECOND = {"s": 1.0, "ms": 1e3, "us": 1e6}
AMPERE = {"A": 1.0, "mA": 1e3}
TORQUE = {"Nm": TORQUE_CONSTANT_NM_PER_A, "mNm": 1e3 * TORQUE_CONSTANT_NM_PER_A}
SIZES = {
    "time": SECOND,
    "position": TURN,
    "velocity": SPEED,
    "reference": SPEED,
    "setpoint": TURN,
    "command": AMPERE,
    "current": AMPERE,
    "torque": TORQUE,
}

SIGNALS = {
    "position": ("position_rev",),
    "velocity": ("velocity_rps",),
    "reference": ("reference_rps",),
    "setpoint": ("setpoint_rev",),
    "command": ("current_command_a",),
    "current": ("current_a",),
    "torque": ("current_a", "measured_torque_nm"),
    "temperature": ("temperature_degc",),
}

LANGUAGES = {
    "en": {
        "time": ("Time", "time", "Timestamp", "t", "Elapsed time"),
        "position": ("Position", "Actual Position", "Angle", "pos_act", "Shaft angle", "motor_pos", "Encoder position"),
        "velocity": ("Velocity", "Actual Velocity", "Speed", "vel_act", "Motor speed", "act speed", "Shaft velocity"),
        "command": ("Current Command", "Commanded current", "current_ref", "Iq ref", "Current setpoint", "i_q_cmd"),
        "current": ("Current", "Actual current", "Iq", "Motor current", "iq_meas", "Phase current q", "Current Actual"),
        "reference": ("Velocity Reference", "Target speed", "vel_cmd", "Speed setpoint", "Demand velocity"),
    },
    "de": {
        "time": ("Zeit", "Zeitstempel", "t"),
        "position": ("Lage-Ist", "Istposition", "Winkel", "Lageistwert", "Ist-Winkel", "Rotorlage"),
        "velocity": ("Drehzahl", "Istdrehzahl", "Geschwindigkeit Ist", "n_ist", "Drehzahlistwert"),
        "command": ("Sollstrom", "Stromsollwert", "I_soll", "Strom Soll"),
        "current": ("Iststrom", "Stromistwert", "Strom", "Motorstrom", "I_ist", "Strom Ist"),
        "reference": ("Solldrehzahl", "Drehzahlsollwert", "n_soll", "Geschwindigkeit Soll"),
    },
    "fr": {
        "time": ("Temps", "temps"),
        "position": ("Position", "Position mesurée", "Angle", "Position réelle"),
        "velocity": ("Vitesse", "Vitesse mesurée", "Vitesse réelle", "Vitesse moteur"),
        "command": ("Consigne courant", "Consigne de courant", "Courant consigne"),
        "current": ("Courant", "Courant mesuré", "Courant moteur", "Courant réel"),
        "reference": ("Consigne vitesse", "Vitesse consigne", "Consigne de vitesse"),
    },
    "it": {
        "time": ("Tempo", "tempo"),
        "position": ("Posizione", "Posizione attuale", "Angolo", "Posizione misurata"),
        "velocity": ("Velocità", "Velocità attuale", "Velocità motore"),
        "command": ("Riferimento corrente", "Corrente di riferimento"),
        "current": ("Corrente", "Corrente misurata", "Corrente motore"),
        "reference": ("Riferimento velocità", "Velocità di riferimento"),
    },
    "es": {
        "time": ("Tiempo", "tiempo"),
        "position": ("Posición", "Posición actual", "Ángulo", "Posición medida"),
        "velocity": ("Velocidad", "Velocidad actual", "Velocidad medida", "Velocidad motor"),
        "command": ("Corriente de referencia", "Consigna de corriente"),
        "current": ("Corriente", "Corriente actual", "Corriente medida", "Corriente motor"),
        "reference": ("Consigna de velocidad", "Velocidad de referencia"),
    },
}
UNIT_WORDS = {  # as people write them
    "s": ("s", "sec"),
    "ms": ("ms", "msec"),
    "us": ("us", "µs"),
    "rev": ("rev", "turns", "U"),
    "rad": ("rad",),
    "deg": ("deg", "°", "degrees"),
    "counts": ("counts", "inc", "cnt"),
    "rps": ("rps", "rev/s", "U/s", "1/s"),
    "rpm": ("rpm", "1/min", "U/min", "min-1"),
    "rad/s": ("rad/s", "rad/sec"),
    "deg/s": ("deg/s", "°/s"),
    "A": ("A", "Amps"),
    "mA": ("mA",),
    "Nm": ("Nm", "N.m"),
    "mNm": ("mNm",),
}
SUFFIXES = {
    "s": "s",
    "ms": "ms",
    "us": "us",
    "rev": "rev",
    "rad": "rad",
    "deg": "deg",
    "counts": "counts",
    "rps": "rps",
    "rpm": "rpm",
    "rad/s": "radps",
    "deg/s": "deg_s",
    "A": "a",
    "mA": "ma",
    "Nm": "nm",
    "mNm": "mnm",
}


class Program(NamedTuple):
    """What a program writes: role -> (heading, unit), the unit being its convention, whatever the heading says."""

    columns: Mapping[str, tuple[str, str]]
    others: Mapping[str, str] = {}  # heading -> kind of column, of OTHERS
    delimiter: str = ","


PROGRAMS = {
    "VESC Tool": Program(
        {
            "time": ("ms_today", "ms"),
            "position": ("encoder_position", "deg"),
            "velocity": ("erpm", "erpm"),
            "current": ("current_motor", "A"),
        },
        {
            "input_voltage": "supply",
            "temp_mos_max": "warm",
            "temp_motor": "temperature",
            "current_in": "supply",
            "d_axis_current": "direct",
            "q_axis_current": "of current",
            "duty_cycle": "duty",
            "tachometer_value": "count",
            "battery_level": "share",
            "fault_code": "zero",
        },
        ";",
    ),
    "ODrive": Program(
        {
            "time": ("timestamp", "s"),
            "position": ("axis0.encoder.pos_estimate", "rev"),
            "velocity": ("axis0.encoder.vel_estimate", "rps"),
            "command": ("axis0.motor.current_control.Iq_setpoint", "A"),
            "current": ("axis0.motor.current_control.Iq_measured", "A"),
        },
        {"vbus_voltage": "supply", "axis0.motor.current_control.Id_measured": "direct"},
    ),
    "ODrive Pro": Program(
        {
            "time": ("time", "s"),
            "position": ("pos_estimate", "rev"),
            "velocity": ("vel_estimate", "rps"),
            "current": ("Iq_measured", "A"),
            "setpoint": ("input_pos", "rev"),
        },
        {"ibus": "supply"},
    ),
    "moteus": Program(
        {
            "time": ("timestamp", "s"),
            "position": ("position", "rev"),
            "velocity": ("velocity", "rps"),
            "torque": ("torque", "Nm"),
        },
        {
            "mode": "ten",
            "q_current": "of current",
            "d_current": "direct",
            "voltage": "supply",
            "temperature": "temperature",
            "fault": "zero",
        },
    ),
    "moteus tview": Program(
        {
            "time": ("timestamp", "s"),
            "position": ("servo_stats.position", "rev"),
            "velocity": ("servo_stats.velocity", "rps"),
            "torque": ("servo_stats.torque_Nm", "Nm"),
            "setpoint": ("servo_stats.control_position", "rev"),
        },
        {"servo_stats.fet_temp_C": "warm", "servo_stats.bus_V": "supply", "servo_stats.d_A": "direct"},
    ),
    "Dynamixel": Program(
        {
            "time": ("time_ms", "ms"),
            "position": ("present_position", "counts"),
            "velocity": ("present_velocity_rpm", "rpm"),
            "current": ("present_current_mA", "mA"),
            "setpoint": ("goal_position", "counts"),
        },
        {"present_temperature": "temperature", "present_input_voltage": "supply", "moving": "flag"},
    ),
    "EPOS Studio": Program(
        {
            "time": ("Time [ms]", "ms"),
            "position": ("Position actual value [inc]", "counts"),
            "velocity": ("Velocity actual value averaged [rpm]", "rpm"),
            "command": ("Current demand value [mA]", "mA"),
            "current": ("Current actual value [mA]", "mA"),
        },
        {"Statusword": "ten"},
        ";",
    ),
    "TwinCAT": Program(
        {
            "time": ("Time [ms]", "ms"),
            "position": ("Axis1.NcToPlc.ActPos [°]", "deg"),
            "velocity": ("Axis1.NcToPlc.ActVelo [°/s]", "deg/s"),
            "reference": ("Axis1.NcToPlc.SetVelo [°/s]", "deg/s"),
            "current": ("Drive.TorqueFeedback [Nm]", "Nm"),
        },
        {"Axis1.NcToPlc.PosDiff": "small"},
        "\t",
    ),
    "Elmo": Program(
        {
            "time": ("Time (s)", "s"),
            "position": ("Position [cnt]", "counts"),
            "velocity": ("Velocity [rpm]", "rpm"),
            "command": ("Current Command [A]", "A"),
            "current": ("Active Current [A]", "A"),
        },
        {"Reactive Current [A]": "direct", "Bus Voltage [V]": "supply"},
    ),
    "ros2 joint_states": Program(
        {
            "time": ("/joint_states/header/stamp", "s"),
            "position": ("/joint_states/position[0]", "rad"),
            "velocity": ("/joint_states/velocity[0]", "rad/s"),
            "torque": ("/joint_states/effort[0]", "Nm"),
        }
    ),
    "PlotJuggler": Program(
        {
            "time": ("__time", "s"),
            "position": ("/joint_states/elbow/position", "rad"),
            "velocity": ("/joint_states/elbow/velocity", "rad/s"),
            "torque": ("/joint_states/elbow/effort", "Nm"),
        }
    ),
    "mujoco": Program(
        {
            "time": ("time", "s"),
            "position": ("qpos", "rad"),
            "velocity": ("qvel", "rad/s"),
            "torque": ("qfrc_actuator", "Nm"),
        },
        {"qacc": "acceleration"},
    ),
    "BAM": Program(
        {
            "time": ("timestamp", "s"),
            "position": ("position", "rad"),
            "velocity": ("speed", "rad/s"),
            "torque": ("torque", "Nm"),
            "setpoint": ("goal_position", "rad"),
        },
        {"input_volts": "supply", "temp": "temperature"},
    ),
    "SimpleFOC": Program(
        {
            "time": ("time_us", "us"),
            "velocity": ("velocity_rad_s", "rad/s"),
            "position": ("angle_rad", "rad"),
            "current": ("current_q_mA", "mA"),
            "reference": ("target_rad_s", "rad/s"),
        },
        {"voltage_q": "of voltage"},
        "\t",
    ),
    "Ingenia": Program(
        {
            "time": ("Time (s)", "s"),
            "position": ("CL_POS_FBK_VALUE (counts)", "counts"),
            "velocity": ("CL_VEL_FBK_VALUE (rev/s)", "rps"),
            "command": ("CL_CUR_Q_REF_VALUE (A)", "A"),
            "current": ("CL_CUR_Q_VALUE (A)", "A"),
        },
        {"CL_CUR_D_VALUE (A)": "direct"},
    ),
    "Sinamics": Program(
        {
            "time": ("Zeit [ms]", "ms"),
            "velocity": ("r61[0] Drehzahlistwert [1/min]", "rpm"),
            "reference": ("r62 Drehzahlsollwert nach Filter [1/min]", "rpm"),
            "command": ("r77 Stromsollwert momentenbildend [A]", "A"),
            "current": ("r78[1] Stromistwert momentenbildend [A]", "A"),
        },
        {"r70 Zwischenkreisspannung Istwert [V]": "supply"},
        ";",
    ),
    "LinuxCNC halscope": Program(
        {
            "time": ("time", "s"),
            "position": ("joint.0.motor-pos-fb [deg]", "deg"),
            "velocity": ("joint.0.vel-fb [deg/s]", "deg/s"),
            "setpoint": ("joint.0.motor-pos-cmd [deg]", "deg"),
            "command": ("joint.0.current-cmd [A]", "A"),
        },
        {"joint.0.f-error": "small"},
    ),
    "Kollmorgen": Program(
        {
            "time": ("Time (ms)", "ms"),
            "position": ("PL.FB (deg)", "deg"),
            "velocity": ("VL.FB (rpm)", "rpm"),
            "reference": ("VL.CMD (rpm)", "rpm"),
            "command": ("IL.CMD (A)", "A"),
            "current": ("IL.FB (A)", "A"),
        }
    ),
}

WRONG = {  # what a heading says -> what is in the column
    "rad called deg": ("position", "deg", "rad"),
    "turns called rad": ("position", "rad", "rev"),
    "rps called rad/s": ("velocity", "rad/s", "rps"),
    "rad/s called rpm": ("velocity", "rpm", "rad/s"),
    "s called ms": ("time", "ms", "s"),
    "ms called s": ("time", "s", "ms"),
    "ten times": ("velocity", "rpm", "tenths"),
    "angle of the output": ("position", "deg", "geared"),
}
GEAR, TENTHS, POLE_PAIRS = 50.0, 10.0, 7
COUNTERS = ("index", "Sample", "n", "#", "No.", "row", "cycle", "tick")
RESTARTS = ("time", "heading")
CLOCKS = ("stamps", "stamps", "stamps", "stamps", "counter", "day", "date", "counter of 16 bits", "from 1970")
REGISTERS = ("none", "none", "none", "two's complement", "sign and magnitude", "offset binary")
OTHERS = (
    "supply",
    "warm",
    "temperature",
    "direct",
    "predicted",
    "count",
    "small",
    "flag",
    "zero",
    "text",
    "acceleration",
)
HEADINGS = {
    "supply": ("Supply voltage [V]", "DC link voltage [V]", "bus_voltage"),
    "warm": ("Board temperature [°C]", "temp_fet"),
    "temperature": ("Motor temperature [°C]", "motor temp [C]"),
    "direct": ("Id [A]", "d-axis current [A]"),
    "predicted": ("torque_model [Nm]", "predicted torque [Nm]"),
    "count": ("cycle", "Counter"),
    "small": ("Following error [deg]", "position error"),
    "flag": ("enabled", "in_position"),
    "zero": ("error code", "fault"),
    "text": ("state", "mode name"),
    "acceleration": ("Acceleration [rad/s^2]", "acc [rad/s2]"),
}


@dataclass
class Case:
    """A log as it is written, and what it is."""

    number: int
    kind: str  # language or program
    how: str  # what makes it hard, for the report
    text: str
    roles: dict[str, str]  # heading -> role, of all columns
    runs: list[dict[str, Floats]]  # signal -> truth, in our units
    undecided: str = ""  # why nobody could know it from the file
    options: list[str] = field(default_factory=list)


def motion(rng: np.random.Generator, rate_hz: float, seconds: float) -> dict[str, Floats]:
    """Truth of a run in our units: multi-sine, triangles with rests, or a staircase of speeds."""
    rows = int(seconds * rate_hz)
    time_s = np.arange(rows) / rate_hz
    fastest = float(rng.choice([2.0, 5.0, 12.0, 30.0]))
    kind = rng.integers(3)
    if kind == 0:
        parts = [
            (rng.uniform(0.2, 1.0), f * rng.uniform(0.8, 1.2), rng.uniform(0, 2 * np.pi)) for f in (0.23, 0.7, 2.1)
        ]
        velocity = sum(a * np.sin(2 * np.pi * f * time_s + p) for a, f, p in parts)
    elif kind == 1:
        phase = np.mod(time_s * rng.uniform(0.2, 0.6), 1.0)
        velocity = np.clip(np.interp(phase, [0, 0.2, 0.4, 0.5, 0.7, 0.9, 1.0], [0, 1, 0, 0, -1, 0, 0]), -0.8, 0.8)
    else:
        levels = np.repeat([0.2, 0.6, 1.0, -0.3, -1.0, 0.0, 0.5, -0.5], rows // 8 + 1)[:rows]
        velocity = levels
    wide = max(3, int(0.08 * rate_hz))
    window = np.hanning(wide + 2)[1:-1]
    velocity = np.convolve(np.pad(velocity, wide, mode="edge"), window / window.sum(), "same")[wide:-wide]
    velocity = fastest * velocity / np.abs(velocity).max()
    reference = np.concatenate([np.repeat(velocity[0], 3), velocity[:-3]])[::1]
    reference, velocity = velocity, reference  # the axis lags
    position = (
        rng.uniform(-0.4, 0.4) + np.concatenate([[0.0], np.cumsum(0.5 * (velocity[1:] + velocity[:-1]))]) / rate_hz
    )
    acceleration = np.gradient(velocity, time_s)
    friction = COULOMB + (STRIBECK - COULOMB) * np.exp(-((velocity / SLIDING_RPS) ** 2))
    wanted = INERTIA * acceleration + friction * np.tanh(velocity / SMOOTH_RPS) + VISCOUS * velocity
    wanted += 0.02 * np.sin(2 * np.pi * 7 * position) + 0.02 * rng.standard_normal(rows)
    noise = rng.uniform(0.01, 0.05) * float(np.std(wanted))
    current = wanted + noise * rng.standard_normal(rows)
    return {
        "time": time_s,
        "position": position,
        "velocity": velocity,
        "reference": reference,
        "setpoint": np.concatenate([[position[0]], position[0] + np.cumsum(reference[1:]) / rate_hz]),
        "command": wanted,
        "current": current,
        "acceleration": acceleration,
    }


def in_unit(role: str, values: Floats, unit: str) -> Floats:
    """Truth as a column has it."""
    if unit == "erpm":
        return np.round(values * 60.0 * POLE_PAIRS)
    if unit == "tenths":
        return values * 60.0 * TENTHS
    if unit == "geared":
        return values * 360.0 / GEAR
    size = {**SIZES[role], **TORQUE}[unit] if role in ("current", "command", "torque") else SIZES[role][unit]
    found = values * size
    return np.floor(found) if unit == "counts" else found


def other(kind: str, run: dict[str, Floats], rng: np.random.Generator) -> Floats | list[str]:
    """A column that is none of the signals."""
    rows = run["time"].size
    noise = rng.standard_normal(rows)
    velocity, current = run["velocity"], run["current"]
    made: dict[str, Callable[[], Floats | list[str]]] = {
        "supply": lambda: 24.0 + 0.05 * noise - 0.02 * np.abs(current),
        "warm": lambda: 41.0 + 2e-4 * np.arange(rows),
        "temperature": lambda: np.round(30.0 + 5.0 * (1.0 - np.exp(-run["time"] / 20.0)), 1),
        "direct": lambda: 0.03 * noise,
        "predicted": lambda: (
            TORQUE_CONSTANT_NM_PER_A
            * (INERTIA * run["acceleration"] + COULOMB * np.tanh(velocity / 0.05) + VISCOUS * velocity)
        ),
        "count": lambda: np.arange(rows, dtype=float),
        "small": lambda: 1e-3 * noise + 1e-3 * velocity,
        "flag": lambda: np.ones(rows),
        "zero": lambda: np.zeros(rows),
        "text": lambda: ["RUN"] * rows,
        "ten": lambda: np.full(rows, 10.0),
        "share": lambda: 0.9 - 1e-5 * np.arange(rows),
        "duty": lambda: velocity / 40.0 + 0.01 * noise,
        "of current": lambda: current + 0.05 * noise,
        "of voltage": lambda: 1.2 * current + 0.3 * velocity + 0.02 * noise,
        "acceleration": lambda: 2.0 * np.pi * run["acceleration"],
    }
    return made[kind]()


def _pick(rng: np.random.Generator, of: object) -> str:
    return str(rng.choice(list(of)))  # type: ignore[call-overload]


def _generic(rng: np.random.Generator) -> tuple[str, dict[str, tuple[str, str]], str]:
    """(language, role -> (heading, unit), way of writing units)."""
    language = _pick(rng, LANGUAGES)
    words = LANGUAGES[language]
    roles = ["time", "position", "velocity"]
    gone = rng.random()
    if gone < 0.15:
        roles.remove("velocity")
    elif gone < 0.3:
        roles.remove("position")
    roles += {0: ["current"], 1: ["command"], 2: ["command", "current"]}[int(rng.integers(3))]
    if rng.random() < 0.4:
        roles.append("reference")
    speed = _pick(rng, SPEED)
    units = {
        "time": _pick(rng, SECOND),
        "position": _pick(rng, TURN),
        "velocity": speed,
        "reference": speed,
        "command": _pick(rng, AMPERE),
    }
    units["current"] = units["command"]
    way = _pick(rng, ["[]", "[]", "()", "suffix", "row", "/"])
    return language, {role: (_pick(rng, words[role]), units[role]) for role in roles}, way


def case(seed: int, number: int) -> Case:
    """One log. The kinds: 45 % with units, 30 % of a program, 13 % without units, 12 % with a heading that lies."""
    rng = np.random.default_rng([seed, number])
    kind_of = rng.random()
    rate_hz = float(rng.choice(RATES_HZ))
    seconds = min(float(rng.uniform(LEAST_S, MOST_S)), MOST_ROWS / rate_hz)
    hard: list[str] = []
    undecided = ""
    others: dict[str, str] = {}
    delimiter, options = _pick(rng, [",", ",", ";", "\t"]), ["--counts-per-turn", "4096"]
    if 0.45 <= kind_of < 0.75:
        kind = _pick(rng, PROGRAMS)
        program = PROGRAMS[kind]
        columns, way, delimiter = dict(program.columns), "none", program.delimiter
        others = {heading: what for heading, what in program.others.items() if rng.random() < 0.8}
        if "erpm" in {unit for _, unit in columns.values()}:
            options += ["--pole-pairs", str(POLE_PAIRS)]
    else:
        kind, columns, way = _generic(rng)
        for what in rng.choice(OTHERS, int(rng.integers(0, 4)), replace=False).tolist():
            others[_pick(rng, HEADINGS[what])] = what
    called = dict(columns)
    if 0.75 <= kind_of < 0.88:
        way = "none"
        undecided = "no units"
    elif kind_of >= 0.88:
        able = [name for name, (role, _, _) in WRONG.items() if role in columns]
        lie = _pick(rng, able)
        role, said, real = WRONG[lie]
        hard.append(lie)
        called[role], columns[role] = (columns[role][0], said), (columns[role][0], real)
        undecided = lie
        for needed in {"position", "velocity"} - {role}:  # without the other nothing contradicts it
            if needed not in columns:
                heading, unit = _pick(rng, LANGUAGES[kind][needed]), "rpm" if needed == "velocity" else "deg"
                columns[needed] = called[needed] = (heading, unit)
    if any(unit == "counts" for _, unit in columns.values()) is False:
        options = options[2:]
    generic = kind in LANGUAGES
    clock = _pick(rng, CLOCKS) if generic and way != "none" and not hard else "stamps"
    if clock != "stamps":
        hard.append(clock)
        unit = {"counter": "", "day": "", "date": "", "counter of 16 bits": "ms", "from 1970": "s"}[clock]
        name = _pick(rng, COUNTERS) if clock == "counter" else columns["time"][0]
        columns["time"] = called["time"] = (name, unit)
    runs = [motion(rng, rate_hz, seconds)]
    restart = _pick(rng, RESTARTS) if generic and clock == "stamps" and not hard and rng.random() < 0.15 else ""
    if restart:
        hard.append(f"begins anew ({restart})")
        runs += [motion(rng, rate_hz, 0.6 * seconds) for _ in range(int(rng.integers(1, 3)))]
    register = _pick(rng, REGISTERS) if generic and not hard and "velocity" in columns and way != "none" else "none"
    if register != "none":
        hard.append(register)
    wraps = "position" in columns and columns["position"][1] != "geared" and rng.random() < 0.3
    shown = {role: _heading(name, unit, way, rng) for role, (name, unit) in called.items()}
    order = [*columns, *others]
    if rng.random() < 0.4:
        tail = order[1:]
        rng.shuffle(tail)
        order = [order[0], *tail]
    decimal = "," if delimiter != "," and generic and rng.random() < 0.5 else "."
    tables = [_table(run, columns, others, order, clock, register, wraps, rng) for run in runs]
    first = [shown.get(one, one) for one in order]
    if len(set(first)) < len(first):
        return case(seed, number + 100_000)
    head = delimiter.join(first)
    units = [called[one][1] if one in called else "" for one in order]
    lines = [head, *([delimiter.join(units)] if way == "row" else [])]
    for k, table in enumerate(tables):
        lines += [head] if k and restart == "heading" else []
        lines += [delimiter.join(row).replace(".", decimal) if decimal == "," else delimiter.join(row) for row in table]
    roles = {shown.get(one, one): one if one in columns else others[one] for one in order}
    return Case(number, kind, ", ".join(hard) or way, "\n".join(lines) + "\n", roles, runs, undecided, options)


def _heading(name: str, unit: str, way: str, rng: np.random.Generator) -> str:
    word = _pick(rng, UNIT_WORDS.get(unit, (unit,)))
    way = way if unit else "none"
    written = {"[]": f"{name} [{word}]", "()": f"{name} ({word})", "/": f"{name} / {word}", "none": name, "row": name}
    return written.get(way) or f"{name.replace(' ', '_')}_{SUFFIXES[unit]}"


def _table(
    run: dict[str, Floats],
    columns: dict[str, tuple[str, str]],
    others: dict[str, str],
    order: list[str],
    clock: str,
    register: str,
    wraps: bool,
    rng: np.random.Generator,
) -> list[tuple[str, ...]]:
    cells: list[list[str]] = []
    for one in order:
        if one == "time":
            cells.append(_stamps(run["time"], columns["time"][1], clock))
            continue
        if one in others:
            values = other(others[one], run, rng)
            cells.append(values if isinstance(values, list) else [f"{v:.7g}" for v in values])
            continue
        truth = run["current"] if one == "torque" else run[one]
        unit = columns[one][1]
        if one == "position":
            truth = np.round(truth * 2.0**16) / 2.0**16
        elif one == "velocity":
            truth = truth + 0.004 * float(np.abs(truth).max()) * rng.standard_normal(truth.size)
        found = in_unit(one, truth, unit)
        if one in ("position", "setpoint") and wraps and unit in TURN:
            found = np.mod(found, TURN[unit])
        if one in ("velocity", "current") and register != "none":
            found = _stored(found, unit, register)
        cells.append([f"{v:.9g}" for v in found])
    return list(zip(*cells, strict=True))


def _stored(values: Floats, unit: str, register: str) -> Floats:
    """Whole numbers of 16 bits without a sign; units that are too coarse for whole numbers are left as they are."""
    if unit not in ("rpm", "deg/s", "mA") or float(np.abs(values).max()) < 300.0:
        return values
    whole = np.round(values)
    if register == "two's complement":
        return np.where(whole < 0.0, whole + 65536.0, whole)
    if register == "sign and magnitude":
        return np.where(whole < 0.0, 32768.0 - whole, whole)
    return whole + 32768.0


def _stamps(time_s: Floats, unit: str, clock: str) -> list[str]:
    if clock == "counter":
        return [str(k) for k in range(time_s.size)]
    if clock in ("day", "date"):
        pattern = "%H:%M:%S.%f" if clock == "day" else "%Y-%m-%d %H:%M:%S.%f"
        return [(MIDNIGHT + datetime.timedelta(seconds=float(t))).strftime(pattern) for t in time_s]
    if clock == "counter of 16 bits":
        return [f"{np.mod(np.round(t * 1e3) + 60_000.0, 65536.0):.0f}" for t in time_s]
    if clock == "from 1970":
        return [f"{1_772_000_000.0 + t:.6f}" for t in time_s]
    return [f"{t * SECOND[unit]:.10g}" for t in time_s]


class Reading(NamedTuple):
    """What became of a run: the columns by signal, and what was read."""

    read: Mapping[str, Floats]  # signal -> values in our units
    columns: Mapping[str, str]  # signal -> heading
    torque_unit: str


def wrong_in(one: Case, readings: list[Reading], name_of: Callable[[str], str]) -> list[str]:
    """What of a log was read wrong, in words; none where everything that was read is true."""
    roles = {name_of(heading): role for heading, role in one.roles.items()} | one.roles
    if len(readings) != len(one.runs):
        return [f"{len(readings)} runs, {len(one.runs)} are in it"]
    found: list[str] = []
    for run, reading in zip(one.runs, readings, strict=True):
        for signal, heading in reading.columns.items():
            role = roles.get(heading, "?")
            able = SIGNALS.get(role, ())
            of_current = signal in ("current_a", "current_command_a")
            near = (
                of_current
                and role in ("current", "command", "torque", "of current")
                and not (
                    {"current", "command"} <= set(roles.values())
                    and role == "current"
                    and signal == "current_command_a"
                )
            )
            if signal != "time_s" and signal not in able and not near:
                found.append(f"{signal} is {heading!r} ({role})")
        found += _scales(run, reading)
    return list(dict.fromkeys(found))


def _scales(run: dict[str, Floats], reading: Reading) -> list[str]:
    time_s = reading.read["time_s"] - reading.read["time_s"][0]
    span = run["time"][-1] * 0.98
    found = []
    rate = float(time_s[-1] / (time_s.size - 1) / run["time"][1])
    if abs(rate - 1.0) > 0.01 or time_s[-1] < span:
        found.append(f"time: {rate:.4g} times the period, {time_s[-1]:.3g} of {run['time'][-1]:.3g} s")
        return found
    torque = TORQUE_CONSTANT_NM_PER_A if reading.torque_unit in ("Nm", "N") else 1.0
    truth = {
        "position_rev": run["position"],
        "velocity_rps": run["velocity"],
        "reference_rps": run["reference"],
        "current_a": torque * run["current"],
        "current_command_a": torque * run["command"],
    }
    signs = {}
    for signal, own in truth.items():
        if signal not in reading.read:
            continue
        value, wanted = reading.read[signal], np.interp(time_s, run["time"], own)
        a, b = value - value.mean(), wanted - wanted.mean()
        alike = float(a @ b / np.sqrt((a @ a) * (b @ b) + 1e-300))
        scale = float(np.std(a) / np.std(b))
        signs[signal] = np.sign(alike)
        if abs(alike) < ALIKE and signal != "current_command_a":
            found.append(f"{signal}: r = {alike:.3f} with the truth")
        elif abs(scale - 1.0) > TOLERANCE + (0.1 if signal.startswith("current") else 0.0):
            found.append(f"{signal}: {scale:.4g} times the truth")
        elif signal == "velocity_rps" and abs(float(value.mean() - wanted.mean() * signs[signal])) > 0.05 * float(
            np.std(b)
        ):
            found.append(f"{signal}: off by {value.mean() - wanted.mean():.3g}")
    if len(set(signs.values())) > 1:
        found.append(f"signs differ: {signs}")
    return found
