"""A vendor's EDS: what is read from it, and the sentence for each way in which it cannot be used."""

import dataclasses

import pytest
from scripted_node import ScriptedNode

from fffo_drive.can.link import free_loopback_port
from fffo_drive.drive.canopen.config import CanopenDriveConfig
from fffo_drive.drive.canopen.drive import CanopenDrive
from fffo_drive.drive.canopen.eds import load_eds
from fffo_drive.drive.canopen.object_map import MappingError
from fffo_drive.drive.port import DriveRefusedError

U8, U16, U32, I8, I16, I32 = "0x0005", "0x0006", "0x0007", "0x0002", "0x0003", "0x0004"
VARIABLES = {
    0x1000: (U32, 0x20192, 0), 0x1005: (U32, 0x80, 0), 0x1016: (U32, 0, 0), 0x1017: (U16, 0, 0), 0x6007: (I16, 1, 0),
    0x6040: (U16, 0, 1), 0x6041: (U16, 0, 1), 0x6060: (I8, 0, 1), 0x6061: (I8, 0, 1), 0x6064: (I32, 0, 1),
    0x606C: (I32, 0, 1), 0x6071: (I16, 0, 1), 0x6077: (I16, 0, 1), 0x6502: (U32, 0x200, 0),
    0x1400: (U32, 0, 0), 0x1800: (U32, 0, 0), 0x1801: (U32, 0, 0), 0x1802: (U32, 0, 0),
    0x1600: (U32, 0, 0), 0x1A00: (U32, 0, 0), 0x1A01: (U32, 0, 0), 0x1A02: (U32, 0, 0),
}  # fmt: skip


def text_of(variables, vendor=0x11, product=0x22, name="drive"):
    lines = ["[FileInfo]", "FileName=x.eds", "[DeviceInfo]", f"VendorNumber={vendor}", f"ProductNumber={product}"]
    lines += [f"ProductName={name}"]
    for index, (data_type, default, mappable) in variables.items():
        lines += [f"[{index:X}]", f"ParameterName=object {index:X}", "ObjectType=0x7", f"DataType={data_type}"]
        lines += ["AccessType=rw", f"DefaultValue={default}", f"PDOMapping={mappable}"]
    return "\n".join(lines) + "\n"


@pytest.fixture
def config(tmp_path):
    return CanopenDriveConfig(
        bus=f"loopback:{free_loopback_port()}",
        node_id=5,
        listen_s=0.02,
        period_ns=500_000,
        counts_per_rev=32768,
        velocity_units_per_rps=1000.0,
        torque_constant_nm_per_a=0.1,
        rated_torque_nm=1.0,
        answer_timeout_s=1.0,
        eds=str(tmp_path / "drive.eds"),
    )


def write(config, text, encoding="utf-8"):
    with open(config.eds, "w", encoding=encoding) as file:
        file.write(text)


def refused(config):
    with pytest.raises(MappingError) as caught:
        CanopenDrive(config)
    assert config.eds in str(caught.value)
    return str(caught.value)


def test_a_drive_with_its_own_eds(config):
    write(config, text_of(VARIABLES))
    with ScriptedNode(config.bus, 5), CanopenDrive(config) as drive:
        assert drive.identity.product_code == 0x22


def test_the_eds_of_another_drive(config):
    write(config, text_of(VARIABLES, product=0x99))
    with ScriptedNode(config.bus, 5), pytest.raises(DriveRefusedError, match=r"product 0x00000099.*0x00000022"):
        CanopenDrive(config).connect()


def test_cp1252_and_a_byte_order_mark_are_read(config):
    for encoding in ("cp1252", "utf-8-sig"):
        write(config, text_of(VARIABLES, name="Antrieb für Prüfstände"), encoding)
        assert load_eds(config.eds, 5).device_information.product_name == "Antrieb für Prüfstände"


def test_a_missing_file(config):
    assert "No such file" in refused(config)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no section [DeviceInfo]"),
        ("this is not an EDS\n", "no section [DeviceInfo]"),
        ("[DeviceInfo]\n", "no object 0x1000"),
        ("stray\n[DeviceInfo]\n", "line 1: 'stray'"),
        ("[DeviceInfo]\n[1000]\nParameterName\n", "line 3: 'ParameterName'"),
        ("[DeviceInfo]\n[1000]\n[1000]\n", "line 3: section [1000] begins again (first in line 2)"),
        ("[DeviceInfo]\n[1000]\nObjectType=0x7\n", "line 2: [1000] has no ParameterName"),
        ("[DeviceInfo]\n[1000]\nParameterName=x\nDataType=\n", "line 4: [1000] has no DataType"),
    ],
)
def test_broken_files(config, text, said):
    write(config, text)
    assert " ".join(said.split()) in refused(config)


def test_numbers_that_are_none(config, caplog):
    write(config, text_of(VARIABLES).replace("VendorNumber=17", "VendorNumber=eleven"))
    CanopenDrive(config)
    assert "line 4: VendorNumber of [DeviceInfo] is 'eleven', which is no number; left out" in caplog.text


def test_a_drive_without_the_mode(config):
    write(config, text_of(VARIABLES | {0x6502: (U32, 0x7F, 0)}))
    assert "drive: there is no mode 10 (cyclic synchronous torque): 0x6502:00 says 0x0000007F" in refused(config)


def test_all_that_is_missing_comes_at_once(config):
    variables = {index: row for index, row in VARIABLES.items() if index not in (0x6007, 0x1801, 0x606C)}
    write(config, text_of(variables | {0x6077: (I16, 0, 0), 0x6071: (I32, 0, 1)}))
    text = refused(config)
    for part in ("object 0x6007:00 is missing", "TPDO2 is missing (0x1801)", "object 0x606C:00 is missing",
                 "0x6077:00/16 cannot be mapped", "0x6071:00/16 has 32 bits"):  # fmt: skip
        assert part in text


def test_the_node_id_of_an_eds_is_ours(config):
    with pytest.raises(MappingError, match="node id 0"):
        load_eds(str(config.eds), 0)
    write(config, text_of(VARIABLES | {0x1014: (U32, "$NODEID+0x80", 0)}))
    assert load_eds(str(config.eds), 5)[0x1014].default == 0x85
    assert dataclasses.replace(config, node_id=6).node_id == 6
