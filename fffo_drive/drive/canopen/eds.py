"""A vendor's EDS (CiA 306): what it says about the objects that the service needs, before the drive is asked.

The parser is `canopen`'s. Files in the wild are often cp1252, whatever the standard says; that is accepted.
"""

from __future__ import annotations

import configparser
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from canopen import ObjectDictionary, ObjectDictionaryError, import_od

from ...can.frame import NODE_IDS
from ..cia402 import SUPPORTS_CYCLIC_SYNCHRONOUS_TORQUE
from ..port import DriveIdentity, DriveRefusedError
from .config import CanopenDriveConfig
from .object_map import MODE, MODE_DISPLAY, MappingError, PdoMap

NEEDED = (0x1005, 0x1016, 0x1017, 0x6007, MODE, MODE_DISPLAY, 0x6502)


def load_eds(path: str, node_id: int) -> Any:
    """The object dictionary of an EDS or DCF file.

    Raises MappingError naming the file and what is wrong in it.
    """
    if node_id not in NODE_IDS:
        raise MappingError(f"node id {node_id}: 1 to 127")
    try:
        raw = Path(path).read_bytes()
    except OSError as error:
        raise MappingError(f"EDS file {path}: {error.strerror}") from error
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("cp1252", errors="replace")
    if "[deviceinfo]" not in text.lower():  # mandatory (CiA 306); and it says whose EDS it is
        raise MappingError(f"EDS file {path}: has no section [DeviceInfo]; is it an EDS?")
    source = io.StringIO(text)
    source.name = path if path.lower().endswith((".eds", ".dcf")) else path + ".eds"
    try:
        dictionary: ObjectDictionary = import_od(source, node_id)
    except configparser.Error as error:
        raise MappingError(f"EDS file {path}: {' '.join(str(error).split())}") from error
    except (KeyError, ValueError, ArithmeticError, ObjectDictionaryError) as error:
        raise MappingError(f"EDS file {path}: cannot be understood: {error!r}") from error
    if 0x1000 not in dictionary:
        raise MappingError(f"EDS file {path}: has no object 0x1000; is it an EDS of a CANopen device?")
    return dictionary


def check_eds(dictionary: Any, config: CanopenDriveConfig) -> None:
    """Refuse a drive that its EDS shows to be unfit. Raises MappingError with all that is missing."""
    problems = list(_missing(dictionary, config))
    if problems:
        raise MappingError(f"EDS file {config.eds}: {'; '.join(problems)}")


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


def _missing(dictionary: Any, config: CanopenDriveConfig) -> Iterator[str]:
    for index in NEEDED:
        if index not in dictionary:
            yield f"object 0x{index:04X} is missing"
    if 0x6502 in dictionary:
        modes = dictionary[0x6502].default
        if modes is not None and not modes & SUPPORTS_CYCLIC_SYNCHRONOUS_TORQUE:
            yield f"0x6502 is 0x{modes:08X}: no cyclic synchronous torque (bit 9)"
    for first, pdo in [(0x1400, config.command), *((0x1800, pdo) for pdo in config.answers)]:
        yield from _missing_in_pdo(dictionary, first + pdo.number - 1, pdo)


def _missing_in_pdo(dictionary: Any, index: int, pdo: PdoMap) -> Iterator[str]:
    if index not in dictionary:
        yield f"PDO 0x{index:04X} is missing"
    for item in pdo.objects:
        variable = dictionary.get_variable(item.index, item.sub)
        if variable is None:
            yield f"object {item}, mapped in 0x{index + 0x200:04X}, is missing"
        elif not variable.pdo_mappable:
            yield f"object {item} cannot be mapped to a PDO"
        elif len(variable) != item.bits:
            yield f"object {item} has {len(variable)} bits"
