"""The configuration of a drive on a bus: its constraints, bus load and timing budget."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from ...can import frame as can
from ...can.load import Chain, Load, Traffic, bus_load, period_chain
from ...units import permille_per_a
from ..cia402 import MODE_CYCLIC_SYNCHRONOUS_TORQUE
from .object_map import (
    COMMAND_OBJECTS,
    CONTROLWORD,
    EVERY_SYNC,
    FEEDBACK_OBJECTS,
    MAX_SYNC_TYPE,
    ON_EVENT,
    POSITION,
    STANDARD_SLOTS,
    STANDARD_TARGET,
    STANDARD_TORQUE,
    STATUSWORD,
    VELOCITY,
    MappedObject,
    MappingError,
    PdoMap,
    PdoSlots,
    Scaling,
    command_pdo,
    feedback_pdos,
    interpolation_period,
)
from .sdo_writes import SdoWrite
from .silence import HEARTBEAT, LIFE_GUARDING, RPDO_TIMER, Detection, Reaction

ModeDisplay = Literal["at_once", "with_sync", "not_checked"]

# every cyclic master sends SYNC or commands within this time, this program a heartbeat; heartbeats of nodes take up to
# 1 s
LISTEN_S = 0.5
HOST_S = 100e-6  # wake-up, reading and computing on an ordinary PC
ONE_MASTER = (
    "one bus has one master, and several axes on one bus under one SYNC are not built yet: end the other master "
    "(a device may send SYNC too: 0x1005, bit 30), or use another bus"
)


@dataclass(frozen=True)
class CanopenDriveConfig:
    """A drive on a bus. Raises MappingError, with all problems at once.

    Ratings are declared and compared with the drive's (0x6076 in its unit, 0x6075 in mA) where it has these
    objects. None for an option code leaves the drive's own setting; None for `rpdo` and `tpdos` is the
    mapping of `object_map`.
    """

    bus: str
    node_id: int
    period_ns: int  # of SYNC
    counts_per_rev: float  # of 0x6064
    velocity_units_per_rps: float  # of 0x606C
    torque_constant_nm_per_a: float
    rated_torque_nm: float
    rated_current_a: float | None = None
    rated_torque_unit_nm: float = 1e-3  # of 0x6076
    rated_current_unit_a: float = 1e-3  # of 0x6075
    inverted: bool = False  # turns the sign of velocity, position and torque together
    bitrate_hz: int = 1_000_000
    master_id: int = 127  # node id of our heartbeat
    status_every: int = 10  # SYNCs
    status_event: int = ON_EVENT
    rpdo: PdoMap | None = None
    tpdos: tuple[PdoMap, ...] | None = None
    slots: PdoSlots = STANDARD_SLOTS
    # what is commanded
    mode: int = MODE_CYCLIC_SYNCHRONOUS_TORQUE  # 0x6060; 4 profile torque, a negative one the vendor's
    target: MappedObject = STANDARD_TARGET
    target_units_per_a: float | None = None  # None: per mille of the rated torque
    torque: MappedObject = STANDARD_TORQUE  # feedback
    torque_units_per_a: float | None = None  # None: as the target's default
    torque_slope: int | None = None  # 0x6087; None: the drive's own
    mode_display: ModeDisplay = "at_once"  # when 0x6061 shows the mode
    device_profile: int | None = 402  # low word of 0x1000; None: any
    modes_listed: bool = True  # 0x6502 names the mode
    # protection of the axis against a silent PC
    silence_detection: Detection = HEARTBEAT
    silence_reaction: Reaction = "abort_connection"
    # reactions to silence
    heartbeat_ms: int = 50  # ours, sent by the loop
    heartbeat_timeout_ms: int = 150  # after which the drive reacts to its absence (0x1016)
    drive_heartbeat_ms: int = 50  # the drive's (0x1017)
    command_timeout_ms: int = 20  # RPDO deadline (0x1400:5) where the drive has it; 0 for none
    abort_connection_option: int = 3  # 0x6007: 1 fault, 2 disable voltage, 3 quick stop
    quick_stop_option: int | None = 2  # 0x605A: ramp, then switch on disabled
    fault_reaction_option: int | None = 2  # 0x605E: quick stop ramp
    max_torque_permille: int | None = None  # 0x6072
    current_limit_a: float | None = None  # of the drive; None: what its objects say
    sdo: tuple[SdoWrite, ...] = ()  # further objects that this drive needs
    warning_codes: tuple[int, ...] = ()  # EMCY codes that are only warnings: reported, without a stop
    unserved_status_bits: tuple[int, ...] = ()  # of the statusword: 9, 12
    # bring-up
    listen_s: float = LISTEN_S  # time of listening on the bus before anything is sent
    answer_timeout_s: float = 0.3  # of one SDO answer
    attempts: int = 3
    start_timeout_s: float = 3.0  # boot-up after a reset, and each change of state
    eds: str | None = None

    def __post_init__(self) -> None:
        problems = list(_problems(self))
        if problems:
            raise MappingError("; ".join(problems))

    @property
    def command(self) -> PdoMap:
        """The RPDO in use."""
        return command_pdo(self.node_id, self.target, self.slots) if self.rpdo is None else self.rpdo

    @property
    def answers(self) -> tuple[PdoMap, ...]:
        """The TPDOs in use."""
        if self.tpdos is not None:
            return self.tpdos
        return feedback_pdos(self.node_id, self.status_every, self.status_event, self.torque, self.slots)

    @property
    def scaling(self) -> Scaling:
        """Factors between the bus and the units of signals.py."""
        sign = -1.0 if self.inverted else 1.0
        permille = permille_per_a(self.torque_constant_nm_per_a, self.rated_torque_nm)
        return Scaling(
            sign / self.velocity_units_per_rps,
            sign / self.counts_per_rev,
            sign * (self.target_units_per_a or permille),
            sign * (self.torque_units_per_a or permille),
        )


def traffic(config: CanopenDriveConfig) -> list[Traffic]:
    """All periodic frames on the bus with this configuration."""
    rate_hz = 1e9 / config.period_ns
    frames = [Traffic("SYNC", can.SYNC, 0, rate_hz)]
    frames.append(Traffic("RPDO1", config.command.cob_id, config.command.data_bytes, rate_hz))
    for pdo in config.answers:
        if 1 <= pdo.transmission <= MAX_SYNC_TYPE:
            name = f"TPDO{pdo.number}"
            frames.append(Traffic(name, pdo.cob_id, pdo.data_bytes, rate_hz / pdo.transmission))
        else:  # on change: with the next SYNC (type 0), or limited by its inhibit time
            most_hz = 1e9 / pdo.inhibit_ns if pdo.inhibit_ns else rate_hz
            frames.append(Traffic(f"TPDO{pdo.number}", pdo.cob_id, pdo.data_bytes, most_hz, on_change=True))
    guarded = config.silence_detection == LIFE_GUARDING  # a request and its answer in place of two heartbeats
    ours, theirs = (config.node_id, config.heartbeat_ms) if guarded else (config.master_id, config.drive_heartbeat_ms)
    frames.append(Traffic("heartbeat", can.HEARTBEAT + ours, 1, 1e3 / config.heartbeat_ms))
    frames.append(Traffic("drive heartbeat", can.HEARTBEAT + config.node_id, 1, 1e3 / theirs))
    return frames


def load_of(config: CanopenDriveConfig) -> Load:
    """Load of the bus by everything periodic."""
    return bus_load(traffic(config), config.bitrate_hz)


def chain_of(config: CanopenDriveConfig, turnaround_s: float, host_s: float) -> Chain:
    """The timing chain of a period in which all synchronous TPDOs are sent."""
    frames = {item.name: item for item in traffic(config)}
    with_sync = {f"TPDO{pdo.number}" for pdo in config.answers if pdo.transmission <= MAX_SYNC_TYPE}
    return period_chain(
        [item for item in frames.values() if item.name in with_sync],
        frames["SYNC"],
        frames["RPDO1"],
        bitrate_hz=config.bitrate_hz,
        period_s=config.period_ns / 1e9,
        turnaround_s=turnaround_s,
        host_s=host_s,
    )


def bus_carries(config: CanopenDriveConfig, turnaround_s: float) -> bool:
    """Whether a period has time for all that is sent in it, when nothing else is in the way."""
    chain = chain_of(config, turnaround_s, HOST_S)
    return load_of(config).worst <= 1.0 and chain.typical_s <= chain.period_s


def _problems(config: CanopenDriveConfig) -> Iterator[str]:
    """Yield all problems, in words."""
    for name in ("node_id", "master_id"):
        if getattr(config, name) not in can.NODE_IDS:
            yield f"{name} {getattr(config, name)}: node ids are 1 to 127"
            return
    if config.node_id == config.master_id:
        yield f"node_id and master_id are both {config.node_id}: two nodes, two ids"
    for name in ("period_ns", "counts_per_rev", "velocity_units_per_rps", "torque_constant_nm_per_a",
                 "rated_torque_nm", "bitrate_hz", "heartbeat_ms", "drive_heartbeat_ms",
                 "attempts"):  # fmt: skip
        if not getattr(config, name) > 0:
            yield f"{name} {getattr(config, name)}: must be above 0"
            return
    if config.heartbeat_timeout_ms < 2 * config.heartbeat_ms:
        yield (
            f"heartbeat_timeout_ms {config.heartbeat_timeout_ms}: at least twice heartbeat_ms "
            f"({2 * config.heartbeat_ms}), or one late heartbeat stops the drive"
        )
    if config.abort_connection_option not in (1, 2, 3):
        yield (f"abort_connection_option {config.abort_connection_option}: 1 fault, 2 disable voltage, 3 quick stop")
    if config.silence_detection == RPDO_TIMER and not config.command_timeout_ms:
        yield "command_timeout_ms 0: silence_detection rpdo_timer needs it"
    two_periods_ms = 2 * config.period_ns / 1e6
    if 0 < config.command_timeout_ms < two_periods_ms:
        yield (
            f"command_timeout_ms {config.command_timeout_ms}: at least twice the period "
            f"({two_periods_ms:g} ms), or one late command stops the drive"
        )
    for name in ("target_units_per_a", "torque_units_per_a"):
        if (value := getattr(config, name)) is not None and not value > 0:
            yield f"{name} {value}: must be above 0"
            return
    if not 1 <= config.status_every <= MAX_SYNC_TYPE:
        yield f"status_every {config.status_every}: 1 to {MAX_SYNC_TYPE} SYNCs"
        return
    for code in config.warning_codes:
        if not 1 <= code <= 0xFFFF:
            yield f"warning_codes 0x{code:X}: EMCY codes are 0x0001 to 0xFFFF (0x0000 says that an error is over)"
    try:
        interpolation_period(config.period_ns)
    except MappingError as error:
        yield str(error)
    yield from _pdo_problems(config)


def _pdo_problems(config: CanopenDriveConfig) -> Iterator[str]:
    answers, command = config.answers, config.command
    every = [command, *answers]
    for pdo, kind in [(command, "RPDO"), *((p, "TPDO") for p in answers)]:
        name = f"{kind}{pdo.number}"
        if not 0x180 < pdo.cob_id < 0x580 or sum(other.cob_id == pdo.cob_id for other in every) > 1:
            yield f"{name} COB-ID 0x{pdo.cob_id:X}: 0x181 to 0x57F, each only once"
        if any(item.bits % 8 for item in pdo.objects) or not 1 <= pdo.data_bytes <= can.MAX_DATA:
            yield f"{name} maps {sum(i.bits for i in pdo.objects)} bits: whole bytes, 1 to 8 of them"
        if not (0 <= pdo.transmission <= MAX_SYNC_TYPE or pdo.transmission in (254, 255)):
            yield f"{name} transmission type {pdo.transmission}: 0 to 240, 254 or 255"
        own = config.target if kind == "RPDO" else config.torque
        known = COMMAND_OBJECTS if kind == "RPDO" else {index: bits for index, (_, bits, _) in FEEDBACK_OBJECTS.items()}
        known = {**known, own.index: own.bits}
        for item in pdo.objects:
            if item.index in known and item.bits != known[item.index]:
                yield f"{name} maps {item}: 0x{item.index:04X} has {known[item.index]} bits"
            if kind == "RPDO" and item.index not in known:
                allowed = ", ".join(f"0x{index:04X}" for index in known)
                yield f"{name} maps {item}: the loop can command {allowed} only"
    for index in (CONTROLWORD, config.target.index):
        if command.offset_of(index) < 0:
            yield f"RPDO{command.number} lacks 0x{index:04X}"
    if command.transmission > MAX_SYNC_TYPE:
        yield f"RPDO{command.number} transmission type {command.transmission}: commands act at SYNC, 0 to 240"
    for index in (VELOCITY, POSITION):
        if not any(p.offset_of(index) >= 0 and p.transmission == EVERY_SYNC for p in answers):
            yield f"no TPDO of transmission type 1 maps 0x{index:04X}"
    for index in (STATUSWORD, config.torque.index):
        if not any(p.offset_of(index) >= 0 for p in answers):
            yield f"no TPDO maps 0x{index:04X}"
