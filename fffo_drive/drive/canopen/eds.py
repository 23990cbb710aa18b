"""A vendor's EDS (CiA 306): the objects that the service needs, checked before the drive is connected.

The parser is that of `canopen`, after the repairs of `eds_tidy`, because vendors' files deviate from the standard.
Repairs are reported with their lines; an unusable file gives a one-sentence error.
"""

from __future__ import annotations

import configparser
import io
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from ...can.frame import NODE_IDS
from ..port import DriveIdentity, DriveRefusedError
from .config import CanopenDriveConfig
from .eds_tidy import EdsRemark, decode, tidy
from .needs import FileObjects, check_modes, needs
from .object_map import MappingError, PdoMap

SHOWN_REMARKS = 10

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
    problems = list(_missing(dictionary, config))
    if problems:
        eds = Eds(str(config.eds), dictionary, ())
        raise MappingError(f"EDS file {config.eds}: {eds.drive_name}: {'; '.join(problems)}")


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


def supported_modes(dictionary: Any) -> int | None:
    """0x6502 if the file states it; 0 and empty mean that the file leaves it to the drive."""
    return default_of(dictionary, 0x6502) or None


def default_of(dictionary: Any, index: int, sub: int = 0) -> int | None:
    """A number of the file: the value of a DCF, else the default; None without either."""
    return FileObjects(dictionary).value(index, sub)


def _missing(dictionary: Any, config: CanopenDriveConfig) -> Iterator[str]:
    objects = FileObjects(dictionary)
    if supported_modes(dictionary):
        yield from check_modes(objects, config)
    yield from needs(objects, config)
    for pdo in (config.command, *config.answers):
        yield from missing_in_pdo(dictionary, pdo)


def declares_mapping(dictionary: Any) -> bool:
    """False for a file that marks no object as mappable: then the drive decides."""
    return any(
        variable.pdo_mappable
        for found in dictionary.values()
        for variable in (found.values() if hasattr(found, "values") else (found,))
    )


def missing_in_pdo(dictionary: Any, pdo: PdoMap) -> Iterator[str]:
    """Why a PDO cannot carry these objects."""
    checked = declares_mapping(dictionary)
    for item in pdo.objects:
        variable = dictionary.get_variable(item.index, item.sub)
        if variable is None:
            continue  # `needs` names it
        if checked and not variable.pdo_mappable:
            yield f"object {item} cannot be mapped to a PDO"
        elif len(variable) != item.bits:
            yield f"object {item} has {len(variable)} bits"
