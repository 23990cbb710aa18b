"""A vendor's EDS (CiA 306): requirements that its drive does not meet, found before it is connected.

The parser is that of `canopen`, after the repairs of `eds_tidy`, because vendors' files deviate from the standard.
Repairs are reported with their lines; an unusable file gives a one-sentence error.
"""

from __future__ import annotations

import configparser
import io
import logging
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from ...can.frame import NODE_IDS
from ...units import NS_PER_S
from ..port import DriveIdentity, DriveRefusedError
from .config import CanopenDriveConfig
from .eds_tidy import SIGNED_BITS, EdsRemark, decode, tidy
from .needs import (
    Need,
    check_device_type,
    check_modes,
    check_objects,
    check_silence,
    current_feedback,
    is_event,
    mode_text,
    no_inhibit_text,
    other_mode,
    pdos_of,
    without_event,
)
from .object_map import (
    EVERY_SYNC,
    MODE,
    ON_EVENT,
    VENDOR_OBJECTS,
    MappingError,
    PdoMap,
    interpolation_period,
    object_name,
)

SHOWN_REMARKS = 10
WRITABLE = ("rw", "rww", "rwr", "wo")
MOST_SLOTS = 64  # PDOs that are looked at
MOST_MAPPED = 64  # objects in a PDO (CiA 301 7.5.2.36)
TORQUE_BITS = (16, 32)  # of an object of torque that the loop can carry
PERIOD_VALUE, PERIOD_EXPONENT = (0x60C2, 1), (0x60C2, 2)
LOWEST_RATE_HZ, HIGHEST_RATE_HZ = 100, 4000  # of a loop that is proposed

_log = logging.getLogger(__name__)


class Eds(NamedTuple):
    """An EDS file that could be read."""

    path: str
    dictionary: Any  # canopen's ObjectDictionary
    remarks: tuple[EdsRemark, ...]  # deviations from CiA 306

    @property
    def drive_name(self) -> str:
        """Vendor and product, as the file has them."""
        device = self.dictionary.device_information
        vendor, product = device.vendor_name or "", device.product_name or ""
        return product if vendor and product.startswith(vendor) else f"{vendor} {product}".strip() or "an unnamed drive"


def read_eds(path: str, node_id: int) -> Eds:
    """An EDS or DCF file, repaired where it is untidy.

    Raises MappingError naming the file and what is wrong in it.
    """
    from canopen import ObjectDictionary, ObjectDictionaryError, import_od  # slower than checking a file

    if node_id not in NODE_IDS:
        raise MappingError(f"node id {node_id}: 1 to 127")
    try:
        raw = Path(path).read_bytes()
    except OSError as error:
        raise MappingError(f"EDS file {path}: {error.strerror}") from error
    text, remarks = decode(raw)
    if "[deviceinfo]" not in text.lower():  # mandatory in CiA 306, and it names the device
        raise MappingError(f"EDS file {path}: has no section [DeviceInfo]; is it an EDS?")
    clean, repairs = tidy(text)
    remarks += repairs
    source = io.StringIO(clean)
    source.name = "tidy.eds"
    try:
        dictionary: ObjectDictionary = import_od(source, node_id)
    except (configparser.Error, KeyError, ValueError, ArithmeticError, ObjectDictionaryError) as error:
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise MappingError(f"EDS file {path}: cannot be understood: {reason}{_beginning(remarks)}") from error
    if 0x1000 not in dictionary:
        raise MappingError(
            f"EDS file {path}: has no object 0x1000; is it an EDS of a CANopen device?{_beginning(remarks)}"
        )
    return Eds(path, dictionary, tuple(remarks))


def load_eds(path: str, node_id: int) -> Any:
    """The object dictionary of an EDS or DCF file; its deviations are logged. Raises as `read_eds`."""
    eds = read_eds(path, node_id)
    for remark in eds.remarks[:SHOWN_REMARKS]:
        _log.warning("EDS file %s: %s", path, remark)
    if len(eds.remarks) > SHOWN_REMARKS:
        more = len(eds.remarks) - SHOWN_REMARKS
        _log.warning("EDS file %s: and %d more; `fffo-drive drive-info %s` lists all", path, more, path)
    return eds.dictionary


def _beginning(remarks: list[EdsRemark]) -> str:
    """The deviations before the failure, for the message."""
    return "".join(f"; {remark}" for remark in remarks[:3])


def check_eds(dictionary: Any, config: CanopenDriveConfig) -> None:
    """Refuse a drive that is unsuitable according to its EDS. Raises MappingError with everything that is missing."""
    found = eds_needs(dictionary, config)
    if found:
        eds = Eds(str(config.eds), dictionary, ())
        raise MappingError(f"EDS file {config.eds}: {eds.drive_name}: {'; '.join(str(need) for need in found)}")


def check_identity(dictionary: Any, identity: DriveIdentity, path: str) -> None:
    """Refuse an EDS of another drive. Raises DriveRefusedError."""
    device = dictionary.device_information
    for name, wanted, found in (
        ("vendor", device.vendor_number, identity.vendor_id),
        ("product", device.product_number, identity.product_code),
    ):
        if wanted and wanted != found:
            raise DriveRefusedError(
                f"EDS file {path} is for {name} 0x{wanted:08X}, the drive says 0x{found:08X} (0x1018); "
                "use the EDS of this drive, or none"
            )


class FileObjects:
    """The objects of an EDS or a DCF. One that describes no object of the vendor's leaves these to the drive."""

    def __init__(self, dictionary: Any) -> None:
        self._dictionary = dictionary  # canopen's ObjectDictionary
        self.vendors_left_out = not any(index in VENDOR_OBJECTS for index in dictionary)

    def has(self, index: int, sub: int = 0) -> bool:
        """Described in the file, or left to the drive."""
        if (sub == 0 and index in self._dictionary) or (self.vendors_left_out and index in VENDOR_OBJECTS):
            return True
        return self._dictionary.get_variable(index, sub) is not None

    def mappable(self, index: int, sub: int = 0) -> bool:
        """Marked so. A file that marks no object at all leaves it to the drive."""
        variable = self._dictionary.get_variable(index, sub)
        return variable is not None and (bool(variable.pdo_mappable) or not declares_mapping(self._dictionary))

    def value(self, index: int, sub: int = 0) -> int | None:
        """The value of a DCF before the default."""
        variable = self._dictionary.get_variable(index, sub)
        for found in (getattr(variable, "value", None), getattr(variable, "default", None)):
            if isinstance(found, int):
                return found
        return None


def supported_modes(dictionary: Any) -> int | None:
    """0x6502 if the file states it; 0 and empty mean that the file leaves it to the drive."""
    return default_of(dictionary, 0x6502) or None


def default_of(dictionary: Any, index: int, sub: int = 0) -> int | None:
    """A number of the file: the value of a DCF, else the default; None without either."""
    return FileObjects(dictionary).value(index, sub)


def left_to_the_drive(dictionary: Any, config: CanopenDriveConfig) -> list[str]:
    """What the drive must have and the file does not say."""
    objects = FileObjects(dictionary)
    found = []
    if config.modes_listed and objects.has(0x6502) and not supported_modes(dictionary):
        found.append(f"mode {mode_text(config.mode)}")
    if objects.vendors_left_out:
        own = [item for item in (config.target, config.torque) if item.index in VENDOR_OBJECTS]
        found += [object_name(item.index, item.sub) for item in own]
    return found


def eds_needs(dictionary: Any, config: CanopenDriveConfig) -> list[Need]:
    """Requirements that the drive does not meet, as far as its file says."""
    objects = FileObjects(dictionary)
    found = check_device_type(objects, config) if objects.value(0x1000) is not None else []
    if supported_modes(dictionary) or not objects.has(0x6502):
        found += check_modes(objects, config)
    found += _check_mode_range(dictionary, config)
    found += check_objects(objects, config)
    found += check_silence(objects, config)
    found += _check_pdos(dictionary, config)
    return found + _check_bit_rate(dictionary, config) + _check_period(dictionary, config)


def _check_mode_range(dictionary: Any, config: CanopenDriveConfig) -> list[Need]:
    """LowLimit and HighLimit of 0x6060 must admit the mode."""
    if _takes(dictionary, (MODE, 0), config.mode):
        return []
    lowest, highest = range_of(dictionary, MODE)
    taken = f"no more than {highest}" if lowest is None else f"{lowest} to {'any' if highest is None else highest}"
    text = f"0x6060:00 takes {taken}, which leaves out mode {mode_text(config.mode)}"
    other = other_mode(config, supported_modes(dictionary) or 0)
    return [Need(text, other if all(_takes(dictionary, (MODE, 0), mode) for mode in other.values()) else {})]


def range_of(dictionary: Any, index: int, sub: int = 0) -> tuple[int | None, int | None]:
    """Lowest and highest value that can be written; None where the file sets no limit.

    Of an object that cannot be written both are its value. 0 to 0, or the lowest above the highest, is no limit.
    """
    variable = dictionary.get_variable(index, sub)
    if variable is None:
        return None, None
    if variable.access_type not in WRITABLE:
        fixed = default_of(dictionary, index, sub)
        return fixed, fixed
    lowest, highest = variable.min, variable.max
    nonsense = lowest is not None and highest is not None and (lowest > highest or lowest == highest == 0)
    return (None, None) if nonsense else (lowest, highest)


def rates_hz(dictionary: Any) -> list[int]:
    """Whole rates of a loop whose period 0x60C2 takes within the limits of the file, slowest first."""
    whole = [rate_hz for rate_hz in range(LOWEST_RATE_HZ, HIGHEST_RATE_HZ + 1) if NS_PER_S % rate_hz == 0]
    return [rate_hz for rate_hz in whole if _takes_period(dictionary, NS_PER_S // rate_hz)]


def _takes_period(dictionary: Any, period_ns: int) -> bool:
    """Whether the limits of 0x60C2 admit a period as it would be written; a drive without the object takes any."""
    if dictionary.get_variable(*PERIOD_VALUE) is None:
        return True
    try:
        value, exponent = interpolation_period(period_ns)
    except MappingError:
        return False
    return _takes(dictionary, PERIOD_VALUE, value) and _takes(dictionary, PERIOD_EXPONENT, exponent)


def _takes(dictionary: Any, where: tuple[int, int], value: int) -> bool:
    """Whether the limits of an object of eight bits admit a value, also where the file has it without a sign."""
    variable = dictionary.get_variable(*where)
    unsigned = variable is not None and variable.data_type not in SIGNED_BITS
    return _within(value & 0xFF if unsigned else value, range_of(dictionary, *where))


def _within(value: int, limits: tuple[int | None, int | None]) -> bool:
    lowest, highest = limits
    return (lowest is None or lowest <= value) and (highest is None or value <= highest)


def _check_period(dictionary: Any, config: CanopenDriveConfig) -> list[Need]:
    """0x60C2 must take the period of the loop."""
    if _takes_period(dictionary, config.period_ns):
        return []
    rate_hz = NS_PER_S / config.period_ns
    lower = [one for one in rates_hz(dictionary) if one < rate_hz]
    taken = f"the next lower rate is {lower[-1]} Hz" if lower else "nor that of a lower rate"
    text = f"0x60C2 takes no period of {1e3 / rate_hz:g} ms, by its limits in the file; {taken}"
    return [Need(text, {"highest_rate_hz": lower[-1]} if lower else {})]


def bit_rates_hz(dictionary: Any) -> list[int]:
    """Bit rates that the file names (BaudRate_*), slowest first; empty where it names none."""
    return sorted(dictionary.device_information.allowed_baudrates)


def _check_bit_rate(dictionary: Any, config: CanopenDriveConfig) -> list[Need]:
    """The drive must know the bit rate of the bus. A loopback bus has none."""
    rates = bit_rates_hz(dictionary)
    if not rates or config.bitrate_hz in rates or config.bus.startswith("loopback:"):
        return []
    known = ", ".join(f"{rate // 1000}" for rate in rates)
    text = f"BaudRate_*: the drive takes {known} kbit/s, the bus has {config.bitrate_hz / 1e3:g}"
    return [Need(text, {"bitrate_hz": rates[-1]})]


# --- PDOs


def declares_mapping(dictionary: Any) -> bool:
    """False for a file that marks no object as mappable: then the drive decides."""
    return any(
        variable.pdo_mappable
        for found in dictionary.values()
        for variable in (found.values() if hasattr(found, "values") else (found,))
    )


def _check_pdos(dictionary: Any, config: CanopenDriveConfig) -> list[Need]:
    """PDOs that are missing, or cannot carry what we want. PDOs of other numbers may."""
    found = [
        (need, is_event(config, kind, pdo))
        for kind, index, pdo in pdos_of(config)
        for need in _pdo_needs(dictionary, config, kind, index, pdo)
    ]
    slots = _fitting_slots(dictionary, config) if found else None
    other = {} if slots in (None, config.slots._asdict()) else {"pdo": slots}
    return [
        need if need.keys else need._replace(keys=other or (without_event(config) if event else {}))
        for need, event in found
    ]


def _pdo_needs(dictionary: Any, config: CanopenDriveConfig, kind: str, index: int, pdo: PdoMap) -> list[Need]:
    """What keeps a PDO from carrying what we want: objects, a mapping that is fixed, a type that it lacks."""
    name = f"{kind}{pdo.number}"
    found = [need._replace(text=f"{name}: {need.text}") for need in _unmapped(dictionary, config, pdo)]
    if dictionary.get_variable(index, 1) is None:
        return [*found, Need(f"{name} is missing (0x{index:04X})")]
    problems = [*_mapping_problems(dictionary, index + 0x200, pdo), *_type_problems(dictionary, index, pdo)]
    found += [Need(f"{name}: {problem}") for problem in problems]
    if pdo.inhibit_ns and dictionary.get_variable(index, 3) is None:
        found.append(Need(no_inhibit_text(name, index), {"status_event": 0}))
    return found


def _unmapped(dictionary: Any, config: CanopenDriveConfig, pdo: PdoMap) -> Iterator[Need]:
    """Objects that no PDO of the drive can carry as we need them. What is missing altogether, `check_objects` names."""
    objects = FileObjects(dictionary)
    for item in pdo.objects:
        variable = dictionary.get_variable(item.index, item.sub)
        if variable is None:
            continue
        bits = len(variable)
        scaled = {config.target: "target", config.torque: "torque_feedback"}.get(item)
        if not objects.mappable(item.index, item.sub):
            yield Need(
                f"object {item} cannot be mapped to a PDO",
                current_feedback(objects, config) if item == config.torque else {},
            )
        elif bits != item.bits:
            fits = scaled is not None and bits in TORQUE_BITS
            yield Need(f"object {item} has {bits} bits", {scaled: {"bits": bits}} if fits and scaled else {})


def _mapping_problems(dictionary: Any, mapping: int, pdo: PdoMap) -> Iterator[str]:
    count = dictionary.get_variable(mapping, 0)
    entries = [dictionary.get_variable(mapping, sub) for sub in range(1, len(pdo.objects) + 1)]
    if count is None or any(entry is None for entry in entries):
        yield f"its mapping 0x{mapping:04X} has too few entries for {len(pdo.objects)} objects"
        return
    mapped = default_of(dictionary, mapping) or 0
    chosen = _writable(entries) and (count.access_type in WRITABLE or mapped == len(pdo.objects))
    fixed = [default_of(dictionary, mapping, sub) for sub in range(1, min(mapped, MOST_MAPPED) + 1)]
    if not chosen and fixed != [item.word for item in pdo.objects]:
        shown = ", ".join(f"0x{word:08X}" for word in fixed if word is not None) or "nothing"
        yield f"its mapping is fixed to {shown}"


def _writable(variables: Iterable[Any]) -> bool:
    return all(variable.access_type in WRITABLE for variable in variables)


def _type_problems(dictionary: Any, index: int, pdo: PdoMap) -> Iterator[str]:
    kind = dictionary.get_variable(index, 2)
    if kind is None:
        yield f"it has no transmission type 0x{index:04X}:02"
        return
    lowest, highest = range_of(dictionary, index, 2)
    if not _within(pdo.transmission, (lowest, highest)):
        allowed = lowest if lowest == highest else f"{lowest} to {highest}"
        name = {EVERY_SYNC: "each SYNC", ON_EVENT: "events"}.get(pdo.transmission, "SYNC")
        yield f"its transmission type is {allowed}, {pdo.transmission} ({name}) is needed"


def _fitting_slots(dictionary: Any, config: CanopenDriveConfig) -> dict[str, int | None] | None:
    """Numbers of PDOs that can carry what we want; None where there are none."""

    def first(kind: str, begin: int, pdo: PdoMap, taken: Iterable[int | None] = ()) -> int | None:
        numbers = [n for n in range(1, MOST_SLOTS + 1) if begin + n - 1 in dictionary and n not in taken]
        return next((n for n in numbers if not _pdo_needs(dictionary, config, kind, begin + n - 1, pdo)), None)

    motion, status, *event = config.answers
    found: dict[str, int | None] = {"command": first("RPDO", 0x1400, config.command)}
    found["motion"] = first("TPDO", 0x1800, motion)
    found["status"] = first("TPDO", 0x1800, status, (found["motion"],))
    if None in found.values():
        return None
    taken = (found["motion"], found["status"])
    found["event"] = first("TPDO", 0x1800, event[0], taken) if event else None
    return found
