"""Configuration of a simulated node: identity, machine, timing, and the faults planned for it."""

from __future__ import annotations

from dataclasses import dataclass, field

from ....can.frame import SYNC
from ....canopen_node.dictionary import WAITS_FOR_MASTER, Value, multiplexer
from ....units import S_PER_MIN, TWO_PI
from ..parameters import DeviceConfig, PlantConfig, PlantConfigError
from ..ranges import NOT_IN_A_FILE, key, note, range_errors
from .faults import Fault
from .foreign_dictionary import ForeignDictionary, derived_modes, entries_of, personality_problems
from .objects import DEVICE_TYPE
from .personality import Personality
from .ratings import Ratings

PERMILLE = 1000.0


@dataclass(frozen=True)
class Identity:
    """Objects 0x1018 and 0x1008 to 0x100A."""

    vendor_id: int = key(0, "-", 0, 0xFFFFFFFF, "0x1018:1")
    product_code: int = key(0x50455332, "-", 0, 0xFFFFFFFF, "0x1018:2; the default reads 2SEP")
    revision: int = key(0x00010000, "-", 0, 0xFFFFFFFF, "0x1018:3")
    serial_number: int = key(1, "-", 0, 0xFFFFFFFF, "0x1018:4")
    device_name: str = note("fffo-drive simulated servo drive", "0x1008")
    hardware_version: str = note("simulated", "0x1009")
    software_version: str = note("0.1", "0x100A")


@dataclass(frozen=True)
class NodeConfig:
    """A simulated drive as a CANopen node."""

    node_id: int = key(1, "-", 1, 127, "node id of the drive")
    plant: PlantConfig = field(default_factory=PlantConfig)
    device: DeviceConfig = field(default_factory=DeviceConfig)
    identity: Identity = field(default_factory=Identity)
    velocity_counts_per_rps: int = key(
        32768, "-", 1, 1 << 24, "0x606C counts in one revolution per second, where no object declares them"
    )
    undervoltage_share: float = key(0.6, "-", 0.0, 1.0, "share of dc_link_v below which the drive trips (0x3220)")
    overvoltage_share: float = key(1.3, "-", 1.0, 10.0, "share of dc_link_v above which the drive trips (0x3210)")
    highest_temperature_k: float = key(80.0, "K", 1.0, 1000.0, "temperature rise at which the drive trips (0x4310)")
    sync_loss_tolerance_ms: int = key(50, "ms", 0, 65535, "default of 0x2010: a longer gap is a loss of SYNC")
    step_by_sync: bool = note(
        False,
        "only SYNC advances the plant, by one period (0x1006, or 0x60C2 where that is 0), and loss of SYNC is not "
        "monitored; false: the plant runs on the clock",
    )
    faults: tuple[Fault, ...] = note((), "faults planned from the start; object 0x2100 injects others")
    personality: Personality = field(default_factory=Personality)
    # of another drive; None: the node's own
    dictionary: ForeignDictionary | None = field(default=None, metadata={NOT_IN_A_FILE: True})
    realtime_priority: int = key(0, "-", 0, 49, "SCHED_FIFO priority of the process; 0: ordinary scheduling")

    def validate(self) -> NodeConfig:
        """Return self if valid. Raises PlantConfigError."""
        self.plant.validate()
        self.device.validate()
        own = [(name, text) for name, text in range_errors(self) if not name.startswith(("plant.", "device."))]
        quirks = self.personality.errors() or list(personality_problems(self))
        own += [(f"personality.{name}", text) for name, text in quirks]
        if self.dictionary is not None:
            wrong = self.dictionary.problems()
            own += [("dictionary", f"0x{entry.index:04X}:{entry.sub:02X} {text}") for entry, text in wrong]
        if own:
            raise PlantConfigError("\n".join(f"node.{name}: {text}" for name, text in own))
        return self

    @property
    def ratings(self) -> Ratings:
        """The name plate shared by plant and device."""
        plant, device = self.plant, self.device
        return Ratings(
            rated_torque_nm=plant.rated_torque_nm,
            torque_constant_nm_per_a=plant.torque_constant_nm_per_a,
            peak_permille=round(PERMILLE * plant.peak_current_a / plant.rated_current_a),
            counts_per_rev=1 << plant.resolver.bits,
            velocity_counts_per_rps=self.velocity_counts_per_rps,
            max_speed_rps=plant.dc_link_v / (TWO_PI * plant.torque_constant_nm_per_a),
            undervoltage_v=self.undervoltage_share * plant.dc_link_v,
            overvoltage_v=self.overvoltage_share * plant.dc_link_v,
            highest_temperature_k=self.highest_temperature_k,
            slow_rps2=device.slow_ramp_rps2,
            quick_rps2=device.quick_ramp_rps2,
            brake_a_per_rps=device.brake_gain_a_per_rps,
            standstill_rps=device.standstill_rps,
        )


def device_defaults(config: NodeConfig) -> dict[int, Value]:
    """Defaults of the configured drive, by `multiplexer(index, sub)`, for objects whose entry has none."""
    identity, ratings, device, personality = config.identity, config.ratings, config.device, config.personality
    values: dict[tuple[int, int], Value] = {
        (0x1008, 0): identity.device_name.encode(),
        (0x1009, 0): identity.hardware_version.encode(),
        (0x100A, 0): identity.software_version.encode(),
        (0x1018, 1): identity.vendor_id,
        (0x1018, 2): identity.product_code,
        (0x1018, 3): identity.revision,
        (0x1018, 4): identity.serial_number,
        (0x2010, 0): config.sync_loss_tolerance_ms,
        (0x605A, 0): device.quick_stop_option,
        (0x605E, 0): device.fault_reaction_option,
        (0x6072, 0): ratings.peak_permille,
        (0x6073, 0): ratings.peak_permille,
        (0x6075, 0): round(ratings.rated_current_a / personality.rated_current_unit_a),
        (0x6076, 0): round(ratings.rated_torque_nm / personality.rated_torque_unit_nm),
        (0x6080, 0): round(ratings.max_speed_rps * S_PER_MIN),
        (0x60E0, 0): ratings.peak_permille,
        (0x60E1, 0): ratings.peak_permille,
    }
    values |= _of_another_drive(config) if config.dictionary is not None else _of_its_own(config)
    return {multiplexer(index, sub): value for (index, sub), value in values.items()}


def _of_its_own(config: NodeConfig) -> dict[tuple[int, int], Value]:
    ratings = config.ratings
    per_rps = ratings.velocity_counts_per_rps
    counts = config.personality.encoder_counts_per_rev or ratings.counts_per_rev
    return {
        (0x6084, 0): max(1, round(ratings.slow_rps2 * per_rps)),
        (0x6085, 0): max(1, round(ratings.quick_rps2 * per_rps)),
        (0x608F, 1): counts,
        (0x6090, 1): per_rps,
        (0x6092, 1): counts,
    }


def _of_another_drive(config: NodeConfig) -> dict[tuple[int, int], Value]:
    """Values by CiA 301 and 402 that the drive's file does not give."""
    return {
        (0x1000, 0): DEVICE_TYPE,
        (0x1005, 0): SYNC,
        (0x1010, 1): 1,
        (0x1011, 1): 1,
        (0x1F80, 0): WAITS_FOR_MASTER,
        (0x6087, 0): 0xFFFFFFFF,
        (0x6502, 0): derived_modes(entries_of(config), config.personality),
    }
