"""The simulated drive of an axis on a loopback bus, which has no hardware: started from the page, as a service."""

from __future__ import annotations

from pathlib import Path

from ..can.frame import SDO_REQUEST, SDO_RESPONSE, pack_frame
from ..can.link import CanFilter, LinkError, open_link
from ..config.axis import AxisFile, read_axis
from ..config.drive_section import CanopenDriveSection
from ..documents import DocumentError
from ..drive.canopen.service import READ_DEVICE_TYPE
from ..system.service_files import example_files

FILE = "simulated_drive.yaml"  # beside the axis file, else the example
ANSWER_S = 0.5


def simulated_on(axis: AxisFile) -> CanopenDriveSection | None:
    """The drive section of an axis on a loopback bus; None for any other."""
    drive = axis.drive
    return drive if isinstance(drive, CanopenDriveSection) and drive.bus.startswith("loopback:") else None


def simulator_words(path: Path, directory: Path) -> tuple[str, ...]:
    """The command that is the drive of an axis file. `directory`: takes the example, where the axis has no file.

    Raises DocumentError for an axis on another bus, and where a drive answers already.
    """
    drive = simulated_on(read_axis(path))
    if drive is None:
        raise DocumentError(f"{path}: its drive is not on a loopback bus, where a simulated one can be")
    if _answers(drive):
        raise DocumentError(f"a drive answers on {drive.bus} as node {drive.node_id} already: use that one")
    file = path.with_name(FILE)
    if not file.exists():
        file = directory / FILE
        file.write_bytes(example_files()[FILE])
    return "sim", str(file), "--bus", drive.bus, "--node", str(drive.node_id)


def _answers(drive: CanopenDriveSection) -> bool:
    """Whether its node answers: two drives with one node id would disturb each other."""
    try:
        with open_link(drive.bus) as link:
            link.set_filters([CanFilter(SDO_RESPONSE + drive.node_id)])
            link.send(pack_frame(SDO_REQUEST + drive.node_id, READ_DEVICE_TYPE))
            return link.receive(ANSWER_S) is not None
    except LinkError as error:
        raise DocumentError(str(error)) from None
