"""The EDS against the device, object by object and over SDO; and against three readers of EDS files."""

from __future__ import annotations

import configparser
import io
import struct
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest
from canopen import import_od
from node.node_rig import Rig

from fffo_drive.cli import main
from fffo_drive.config.eds_fitness import fitness_of
from fffo_drive.drive.canopen.eds import read_eds
from fffo_drive.drive.simulated.node.config import Identity, NodeConfig
from fffo_drive.drive.simulated.node.eds import eds_text

NODE = 1
FORMATS = {0x02: "<b", 0x03: "<h", 0x04: "<i", 0x05: "<B", 0x06: "<H", 0x07: "<I"}
TEXT = 0x09
READ_ONLY, WRITE_ONLY, NO_OBJECT, NO_SUB = 0x06010002, 0x06010001, 0x06020000, 0x06090011
TOO_LONG, TOO_SHORT, TOO_HIGH, TOO_LOW = 0x06070012, 0x06070013, 0x06090031, 0x06090032
NOT_MAPPABLE = 0x06040041
SAVE = {0x1010: int.from_bytes(b"save", "little"), 0x1011: int.from_bytes(b"load", "little")}
# what may refuse a value that the type and the limits allow: states, and other objects
CONDITIONAL = {
    0x06010000,
    0x06040041,
    0x06040042,
    0x06040043,
    0x06020000,
    0x06090030,
    0x06090031,
    0x08000020,
    0x08000022,
}


class Described(NamedTuple):
    """What the EDS says of one sub-index."""

    index: int
    sub: int
    data_type: int
    access: str
    default: str | None
    low: int | None
    high: int | None
    mappable: bool

    @property
    def multiplexer(self) -> tuple[int, int]:
        return self.index, self.sub

    @property
    def size(self) -> int:
        return struct.calcsize(FORMATS[self.data_type]) if self.data_type in FORMATS else 0

    def value(self) -> int | bytes:
        text = self.default or "0"
        if self.data_type == TEXT:
            return (self.default or "").encode()
        return sum(NODE if part == "$NODEID" else int(part, 0) for part in text.split("+"))


def described() -> list[Described]:
    """The file, read by the rules of CiA 306 and nothing else."""
    parser = configparser.ConfigParser(interpolation=None, strict=True)
    parser.optionxform = str  # type: ignore[assignment]
    parser.read_string(eds_text(NodeConfig(node_id=NODE)))
    listed = [
        int(parser[section][str(k)], 16)
        for section in ("MandatoryObjects", "OptionalObjects", "ManufacturerObjects")
        for k in range(1, int(parser[section]["SupportedObjects"]) + 1)
    ]
    found = []
    for index in listed:
        head = parser[f"{index:04X}"]
        count = int(head.get("SubNumber", "0"))
        names = [s for s in parser.sections() if s.startswith(f"{index:04X}sub")] if count else [f"{index:04X}"]
        assert len(names) == max(1, count)
        for name in names:
            entry = parser[name]
            low, high = (int(entry[key], 0) if key in entry else None for key in ("LowLimit", "HighLimit"))
            sub = int(name.partition("sub")[2] or "0", 16)
            found.append(
                Described(index, sub, int(entry["DataType"], 16), entry["AccessType"], entry.get("DefaultValue"), low,
                          high, entry["PDOMapping"] == "1")
            )  # fmt: skip
    return found


ENTRIES = described()


def upload(rig: Rig, index: int, sub: int) -> tuple[bytes, int]:
    """Value and abort code, by whatever transfer the server takes."""
    first, abort = rig._answer(struct.pack("<BHB4x", 0x40, index, sub))
    if abort:
        return b"", abort
    if first[0] & 2:
        return first[4 : 8 - (first[0] >> 2 & 3)], 0
    data, toggle = b"", 0
    while True:
        part, _ = rig._answer(bytes([0x60 | toggle << 4]) + bytes(7))
        data += part[1 : 8 - (part[0] >> 1 & 7)]
        toggle ^= 1
        if part[0] & 1:
            return data, 0


def download(rig: Rig, index: int, sub: int, data: bytes) -> int:
    """Abort code of an expedited download of 1 to 4 bytes."""
    command = 0x23 | (4 - len(data)) << 2
    return rig._answer(struct.pack("<BHB4s", command, index, sub, data))[1]


@pytest.mark.conformance("CiA 301", "EDS: access, type, default, limits and PDO flag of every object equal the device")
def test_access_and_type_of_every_object() -> None:
    rig = Rig()
    for entry in ENTRIES:
        data, abort = upload(rig, *entry.multiplexer)
        if entry.access == "wo":
            assert abort == WRITE_ONLY, entry
        elif (entry.index, entry.sub > 0) == (0x1003, True):
            assert abort == 0x08000024, entry  # no error yet
        else:
            assert abort == 0, entry
            assert entry.data_type == TEXT or len(data) == entry.size, entry
        abort = download(rig, *entry.multiplexer, bytes(entry.size or 4))
        if entry.access in ("ro", "const"):
            assert abort == READ_ONLY, entry
        else:
            assert abort == 0 or abort in CONDITIONAL | {TOO_LOW}, (entry, hex(abort))
            if entry.size:
                assert entry.size == 4 or download(rig, *entry.multiplexer, bytes(entry.size + 1)) == TOO_LONG, entry
                assert entry.size == 1 or download(rig, *entry.multiplexer, bytes(entry.size - 1)) == TOO_SHORT, entry


@pytest.mark.conformance("CiA 301", "EDS: access, type, default, limits and PDO flag of every object equal the device")
def test_default_of_every_object() -> None:
    rig = Rig()
    for entry in ENTRIES:
        if entry.access in ("ro", "wo"):
            assert entry.default is None or entry.access == "wo", entry  # measured: no default
            continue
        data, _ = upload(rig, *entry.multiplexer)
        value = entry.value()
        assert data == (value if isinstance(value, bytes) else struct.pack(FORMATS[entry.data_type], value)), entry


@pytest.mark.conformance("CiA 301", "EDS: access, type, default, limits and PDO flag of every object equal the device")
def test_limits_of_every_object() -> None:
    for entry in ENTRIES:
        if entry.access in ("ro", "const") or entry.data_type == TEXT:
            continue
        packing = struct.Struct(FORMATS[entry.data_type])
        bits = 8 * packing.size
        signed = packing.format.islower()
        lowest, highest = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
        low, high = (lowest if entry.low is None else entry.low), (highest if entry.high is None else entry.high)
        for value, refusal in ((low, 0), (high, 0), (low - 1, TOO_LOW), (high + 1, TOO_HIGH)):
            if not lowest <= value <= highest:
                continue
            abort = download(Rig(), *entry.multiplexer, packing.pack(value))
            if refusal:
                assert abort == refusal, (entry, value)
            else:
                assert abort in {0} | CONDITIONAL, (entry, value, hex(abort))


@pytest.mark.conformance("CiA 301", "EDS: access, type, default, limits and PDO flag of every object equal the device")
def test_pdo_flag_of_every_object() -> None:
    rig = Rig()
    for communication, cob_id in ((0x1400, 0x80000201), (0x1800, 0xC0000181)):
        assert rig.write(communication, 1, cob_id, 4) == 0
        assert rig.write(communication + 0x200, 0, 0, 1) == 0
    for entry in ENTRIES:
        word = entry.index << 16 | entry.sub << 8 | 8 * entry.size
        received = rig.write(0x1600, 1, word, 4)
        sent = rig.write(0x1A00, 1, word, 4)
        assert (sent == 0) == (entry.mappable and entry.access in ("ro", "rw", "rwr")), entry
        assert (received == 0) == (entry.mappable and entry.access in ("wo", "rw", "rww")), entry
        assert {sent, received} <= {0, NOT_MAPPABLE}


def test_nothing_is_in_the_device_that_is_not_in_the_file() -> None:
    rig = Rig()
    indices = {entry.index for entry in ENTRIES}
    multiplexers = {entry.multiplexer for entry in ENTRIES}
    for index in range(0x10000):
        if index not in indices:
            assert rig.read_abort(index, 0) == NO_OBJECT
    for index in sorted(indices):
        for sub in range(256):
            if (index, sub) not in multiplexers:
                assert rig.read_abort(index, sub) == NO_SUB


@pytest.mark.conformance("CiA 301", "EDS passes dcfchk")
def test_dcfchk_accepts_it(tmp_path: Path) -> None:
    path = tmp_path / "drive.eds"
    path.write_text(eds_text(NodeConfig()), encoding="ascii")
    checker = Path(sys.executable).with_name("dcfchk")
    done = subprocess.run([checker, "-n", "1", path], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_canopen_reads_what_the_device_says() -> None:
    source = io.StringIO(eds_text(NodeConfig(node_id=5)))
    source.name = "drive.eds"
    od = import_od(source, 5)
    rig = Rig(NodeConfig(node_id=5))
    for entry in rig.node.od.entries:
        variable = od.get_variable(entry.index, entry.sub)
        assert (variable.data_type, variable.access_type) == (entry.data_type, entry.access)
        assert (variable.min, variable.max) == (entry.low, None if entry.data_type == TEXT else entry.high)
        assert variable.pdo_mappable is entry.mappable
        if entry.access == "ro":
            assert variable.default is None
        elif entry.data_type != TEXT:
            assert variable.default == rig.node.od.power_on_value(entry)


@pytest.mark.conformance("CiA 301", "device type 0x1000 is a servo drive", "identity 0x1018")
def test_identity() -> None:
    identity = Identity(vendor_id=0x1234, product_code=0xABCD, revision=0x10002, serial_number=77)
    config = NodeConfig(identity=identity)
    rig = Rig(config)
    assert rig.read(0x1000) == 0x00020192
    assert [rig.read(0x1018, sub) for sub in range(5)] == [4, 0x1234, 0xABCD, 0x10002, 77]
    assert "VendorNumber=0x00001234\n" in eds_text(config)


def test_the_command_writes_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drive, eds = tmp_path / "drive.yaml", tmp_path / "bench.eds"
    drive.write_text("format: fffo_drive/simulated/1\nidentity: {vendor_id: 17}\n")
    assert main(["sim", str(drive), "--eds", str(eds)]) == 0
    assert "bench.eds" in capsys.readouterr().out
    assert "FileName=bench.eds" in eds.read_text()
    read = read_eds(str(eds), 3)
    assert read.dictionary.device_information.vendor_number == 17
    assert read.remarks == ()
    assert fitness_of(read, 3).refusals == fitness_of(read, 3).welcome_missing == ()
