"""The configuration of a simulated drive, as written in its file. `pack` converts it to the kernels' arrays.

The end-to-end delay is configured as one number, `delay_s`, because that can be measured on a drive: from the sample on
which a command was computed to the resulting change of the reported velocity. It is the sum of

    the bus tick        sync_period_s: a command of sample k acts at SYNC k+1
    the hold            sync_period_s/2: it is held for one period, on average half a period old
    the transport       what remains: time that drive software and power stage take
    the current loop    2 h/a - h/(1 + exp(-h R/L)), h = 1/22 kHz, a = 1 - exp(-2 pi current_bandwidth_hz 2 h)
    the tracking loop   2 zeta/wn - h/2 of the resolver's velocity estimate

`delay_budget` gives the parts; a test measures the sum on the plant.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from .braking import BrakeSettings
from .cia402_device import QUICK_STOP_OPTION_DEFAULT
from .effects.registry import EFFECTS, effect_errors, effect_values, is_present
from .ranges import key, note, range_errors, required_note
from .state import STEP_S
from .surfaces import PlantFriction


class PlantConfigError(ValueError):
    """An invalid configuration of a drive; the text has a line for each wrong key."""


@dataclass(frozen=True)
class ResolverConfig:
    """Resolver, converter and tracking loop."""

    bits: int = key(15, "-", 8, 24, "bits per revolution")
    tracking_hz: float = key(400.0, "Hz", 20.0, 2000.0, "natural frequency of the tracking loop")
    tracking_damping: float = key(0.9, "-", 0.3, 3.0, "damping ratio of the tracking loop")
    noise_rev: float = key(1.5e-5, "rev", 0.0, 0.01, "standard deviation of the converted angle")
    velocity_noise_rps: float = key(0.008, "rps", 0.0, 10.0, "additional noise of the reported velocity")
    velocity_lsb_rps: float = key(0.001, "rps", 0.0, 1.0, "resolution of the reported velocity; 0 for none")


@dataclass(frozen=True)
class ThermalConfig:
    """First-order warm-up caused by the losses of winding and friction, and its influence on friction and an offset."""

    k_per_w: float = key(1.5, "K/W", 0.0, 1000.0, "final temperature rise per watt of loss")
    time_constant_s: float = key(600.0, "s", 1.0, 1e5, "thermal time constant")
    viscous_per_k: float = key(-0.01, "1/K", -0.1, 0.1, "relative change of viscous friction")
    coulomb_per_k: float = key(0.0, "1/K", -0.1, 0.1, "relative change of the friction level")
    offset_nm_per_k: float = key(0.0, "Nm/K", -1.0, 1.0, "change of the constant load torque")


@dataclass(frozen=True)
class EffectConfig:
    """An effect that is switched on. Missing parameters have the defaults of the registry."""

    name: str = required_note("as `fffo-drive config effects` lists it")
    parameters: Mapping[str, float] = note({}, "by name; the others have the defaults listed there")


@dataclass(frozen=True)
class DelayBudget:
    """Parts of the end-to-end delay, in seconds."""

    bus_tick_s: float
    hold_s: float
    transport_s: float  # negative: delay_s is shorter than the other parts
    current_loop_s: float
    tracking_loop_s: float


@dataclass(frozen=True)
class PlantConfig:
    """A drive and its axis. The defaults are those of the paper's setup, with five frictional surfaces."""

    inertia_kg_m2: float = key(1.5e-4, "kg m^2", 1e-7, 100.0, "inertia at the motor shaft")
    torque_constant_nm_per_a: float = key(0.148, "Nm/A", 1e-4, 100.0, "torque constant")
    rated_current_a: float = key(8.3, "A", 0.01, 1000.0, "rated current")
    peak_current_a: float = key(16.6, "A", 0.01, 3000.0, "current limit of the drive")
    dc_link_v: float = key(48.0, "V", 1.0, 1000.0, "DC-link voltage")
    resistance_ohm: float = key(0.35, "ohm", 1e-3, 100.0, "resistance of the winding")
    electrical_time_constant_s: float = key(1.2e-3, "s", 2e-4, 0.1, "L/R of the winding")
    current_bandwidth_hz: float = key(1000.0, "Hz", 50.0, 5000.0, "bandwidth of the current loop (rate 11 kHz)")
    gear_ratio: float = key(160.0, "-", 0.001, 1e4, "motor speed over output speed")
    delay_s: float = key(0.003, "s", 0.0, 0.1, "total end-to-end delay")
    sync_period_s: float = key(0.0005, "s", 1e-4, 0.1, "SYNC period for which delay_s is specified")
    extra_delay_s: float = key(0.0, "s", 0.0, 0.5, "transport delay beyond delay_s")
    current_noise_a: float = key(0.01, "A", 0.0, 10.0, "noise of the measured current")
    roughness_nm: float = key(0.0004, "Nm", 0.0, 1.0, "standard deviation of the torque noise of rough surfaces")
    roughness_hz: float = key(15.0, "Hz", 0.01, 2000.0, "its bandwidth")
    initial_angle_rev: float = key(0.0, "rev", -1e4, 1e4, "angle of the motor shaft at power-on")
    motor_inertia_share: float = key(1.0, "-", 0.05, 1.0, "share of the inertia on the motor shaft (effects)")
    seed: int = key(1, "-", 0, 2**63 - 1, "seed of all noise")
    resolver: ResolverConfig = field(default_factory=ResolverConfig)
    thermal: ThermalConfig = field(default_factory=ThermalConfig)
    friction: PlantFriction = field(default_factory=PlantFriction)
    effects: tuple[EffectConfig, ...] = note((), "effects that are switched on")

    @property
    def rated_torque_nm(self) -> float:
        """Value of 0x6076, in Nm: rated current times torque constant."""
        return self.rated_current_a * self.torque_constant_nm_per_a

    def errors(self) -> list[tuple[str, str]]:
        """All problems: pairs of dotted key and text with the allowed range."""
        found = range_errors(self)
        found += self.friction.errors("friction.")
        for k, effect in enumerate(self.effects):
            found += [(f"effects[{k}].{name}", text) for name, text in effect_errors(effect.name, effect.parameters)]
        if found:
            return found
        if self.delay_s > 0.0 and delay_budget(self).transport_s < 0.0:
            least_s = self.delay_s - delay_budget(self).transport_s
            found.append(("delay_s", f"{self.delay_s:g} is shorter than the fixed parts together, {least_s:.6f} s"))
        prepared = self.prepared()
        for name, text in range_errors(prepared):
            found.append((name, f"{text}, with all effects applied"))
        return found

    def validate(self) -> PlantConfig:
        """Self, when nothing is wrong. Raises PlantConfigError."""
        found = self.errors()
        if found:
            raise PlantConfigError("\n".join(f"plant.{name}: {text}" for name, text in found))
        return self

    def present_effects(self) -> list[tuple[str, dict[str, float]]]:
        """Effects of nonzero strength, each with all its parameters."""
        pairs = [(e.name, effect_values(e.name, e.parameters)) for e in self.effects]
        return [(name, values) for name, values in pairs if is_present(name, values)]

    def prepared(self) -> PlantConfig:
        """The configuration after the effects that change it (delay, voltage, shapes, inertia)."""
        config = self
        for name, values in self.present_effects():
            prepare = EFFECTS[name].prepare
            if prepare is not None:
                config = prepare(config, values)
        return config


def paper_plant() -> PlantConfig:
    """The axis that the model describes exactly: one 2SEP surface, no roughness, no warming.

    Delay, current loop, resolver and their noise are those of the default.
    """
    return PlantConfig(
        friction=PlantFriction(kind="single_2sep"),
        roughness_nm=0.0,
        thermal=ThermalConfig(viscous_per_k=0.0, coulomb_per_k=0.0),
    )


def noiseless(config: PlantConfig) -> PlantConfig:
    """The same drive with an ideal sensor: no noise, no roughness, finest resolution."""
    resolver = replace(config.resolver, bits=24, noise_rev=0.0, velocity_noise_rps=0.0, velocity_lsb_rps=0.0)
    return replace(config, resolver=resolver, current_noise_a=0.0, roughness_nm=0.0)


def delay_budget(config: PlantConfig) -> DelayBudget:
    """Parts of `delay_s`; see the module docstring."""
    tick_s = config.sync_period_s
    kept = math.exp(-STEP_S / config.electrical_time_constant_s)
    approach = 1.0 - math.exp(-4.0 * math.pi * config.current_bandwidth_hz * STEP_S)
    current_s = 2.0 * STEP_S / approach - STEP_S / (1.0 + kept)
    r = config.resolver
    tracking_s = r.tracking_damping / (math.pi * r.tracking_hz) - 0.5 * STEP_S
    transport_s = config.delay_s - 1.5 * tick_s - current_s - tracking_s
    return DelayBudget(tick_s, 0.5 * tick_s, transport_s, current_s, tracking_s)


@dataclass(frozen=True)
class DeviceConfig:
    """Behaviour of the drive as a CiA 402 device, in process."""

    status_period: int = key(10, "-", 1, 10_000, "statusword and current are sent every so many SYNCs")
    turnaround_s: float = key(0.0, "s", 0.0, 0.1, "from SYNC to the drive's answer")
    quick_stop_option: int = key(QUICK_STOP_OPTION_DEFAULT, "-", 0, 7, "0x605A: 0 to 3, 5 to 7")
    fault_reaction_option: int = key(2, "-", 0, 3, "0x605E: 0 coast, 1 slow ramp, 2 quick ramp, 3 current limit")
    slow_ramp_rps2: float = key(50.0, "rps2", 0.01, 1e5, "deceleration of the slow down ramp")
    quick_ramp_rps2: float = key(200.0, "rps2", 0.01, 1e5, "deceleration of the quick stop ramp")
    brake_gain_a_per_rps: float = key(0.4, "A/rps", 1e-3, 100.0, "gain of the drive's own speed loop")
    standstill_rps: float = key(0.1, "rps", 1e-4, 10.0, "speed below which the shaft counts as stopped")

    def validate(self) -> DeviceConfig:
        """Self, when nothing is wrong. Raises PlantConfigError."""
        found = range_errors(self)
        if self.quick_stop_option == 4:
            found.append(("quick_stop_option", "4 (voltage limit) is not supported; 0 to 3 and 5 to 7 are"))
        if found:
            raise PlantConfigError("\n".join(f"device.{name}: {text}" for name, text in found))
        return self

    def brake(self, peak_current_a: float) -> BrakeSettings:
        """The brake's constants."""
        return BrakeSettings(
            slow_rps2=self.slow_ramp_rps2,
            quick_rps2=self.quick_ramp_rps2,
            gain_a_per_rps=self.brake_gain_a_per_rps,
            limit_a=peak_current_a,
            standstill_rps=self.standstill_rps,
        )
