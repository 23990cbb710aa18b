"""SDO block transfer in frames: both directions, CRC, lost segments, and what is refused."""

from __future__ import annotations

import struct

import pytest
from canopen import ObjectDictionary
from canopen.sdo.client import SdoClient
from node.node_rig import Rig

from fffo_drive.can.frame import pack_frame, unpack_frame
from fffo_drive.canopen_node.sdo_block import block_crc

NAME = b"fffo-drive simulated servo drive"  # 32 bytes: five segments, three bytes unused
BEGIN_UPLOAD = "601#A40810007F000000"
UPLOAD_BEGUN = "581#C608100020000000"
TEXT = bytes(range(33, 33 + 64))  # ten segments, six bytes unused


def begin_upload(block: int = 0x7F) -> Rig:
    rig = Rig()
    assert rig.send(f"601#A4081000{block:02X}000000") == [UPLOAD_BEGUN]
    return rig


def begin_download(size: int = 64, crc: bool = True) -> Rig:
    rig = Rig()
    answer = rig.send(f"601#{0xC2 | crc << 2:02X}002000" + struct.pack("<I", size).hex())
    assert answer == ["581#A40020007F000000"]
    return rig


def segment(number: int, data: bytes) -> str:
    return f"601#{number:02X}" + data.ljust(7, b"\0").hex()


def parts(data: bytes) -> list[bytes]:
    return [data[k : k + 7] for k in range(0, len(data), 7)]


def send_all(rig: Rig, data: bytes) -> list[str]:
    sent: list[str] = []
    pieces = parts(data)
    for number, piece in enumerate(pieces, 1):
        sent += rig.send(segment(number | (0x80 if number == len(pieces) else 0), piece))
    return sent


def end(rig: Rig, data: bytes, crc: int) -> list[str]:
    return rig.send(f"601#{0xC1 | (-len(data) % 7) << 2:02X}" + struct.pack("<H5x", crc).hex())


def test_the_crc_is_that_of_the_standard() -> None:
    assert block_crc(b"123456789") == 0x31C3


@pytest.mark.conformance("CiA 301", "block transfer with CRC, in both directions")
def test_upload_in_one_block() -> None:
    begin_upload().script(f"""
        > 601#A300000000000000
        < 581#016666666F2D6472
        < 581#026976652073696D
        < 581#03756C6174656420
        < 581#04736572766F2064
        < 581#8572697665000000
        > 601#A2057F0000000000
        < 581#CD{struct.pack("<H", block_crc(NAME)).hex()}0000000000
        > 601#A100000000000000
        + 5000                  ; it is over: no time-out
    """)


def test_upload_in_small_blocks_and_a_lost_segment_comes_again() -> None:
    begin_upload(block=2).script(
        """
        > 601#A300000000000000
        < 581#016666666F2D6472
        < 581#026976652073696D
        > 601#A201020000000000  ; only the first arrived
        < 581#016976652073696D
        < 581#02756C6174656420
        > 601#A2027F0000000000
        < 581#01736572766F2064
        < 581#8272697665000000
        > 601#A2027F0000000000
        < 581#CD09D20000000000
    """.replace("09D2", struct.pack("<H", block_crc(NAME)).hex())
    )


def test_little_data_goes_in_segments_where_the_client_says_so() -> None:
    Rig().script("""
        > 601#A40810007F400000  ; up to 64 bytes rather so
        < 581#4108100020000000
        > 601#6000000000000000
        < 581#006666666F2D6472
    """)


@pytest.mark.conformance("CiA 301", "block transfer with CRC, in both directions")
def test_download_and_its_last_bytes() -> None:
    rig = begin_download()
    assert send_all(rig, TEXT) == ["581#A20A7F0000000000"]
    assert end(rig, TEXT, block_crc(TEXT)) == ["581#A100000000000000"]
    assert rig.node.od.upload(0x2000, 0) == TEXT
    assert rig.wait(5000) == []


def test_segments_after_a_lost_one_are_not_taken_and_come_again() -> None:
    rig = begin_download()
    pieces = parts(TEXT)
    for number in (1, 2, 4, 5, 6, 7, 8, 9):  # the third is lost
        assert rig.send(segment(number, pieces[number - 1])) == []
    assert rig.send(segment(10 | 0x80, pieces[9])) == ["581#A2027F0000000000"]
    assert send_all(rig, TEXT[14:]) == ["581#A2087F0000000000"]
    assert end(rig, TEXT, block_crc(TEXT)) == ["581#A100000000000000"]
    assert rig.node.od.upload(0x2000, 0) == TEXT


def test_a_number_by_block_without_crc_or_size() -> None:
    rig = Rig()
    rig.script("""
        > 601#C006100000000000
        < 581#A40610007F000000
        > 601#81F4010000000000
        < 581#A2017F0000000000
        > 601#CD00000000000000
        < 581#A100000000000000
    """)
    assert rig.read(0x1006) == 500


@pytest.mark.conformance("CiA 301", "block size (05040002)")
def test_block_sizes_out_of_range() -> None:
    for size in (0, 128, 255):
        assert Rig().send(f"601#A4081000{size:02X}000000") == ["581#8008100002000405"]
    rig = begin_upload()
    rig.send("601#A300000000000000")
    assert rig.send("601#A205800000000000") == ["581#8008100002000405"]


@pytest.mark.conformance("CiA 301", "sequence number in a block (05040003)")
def test_sequence_numbers_that_cannot_be() -> None:
    rig = begin_download()
    assert rig.send(segment(0, b"")) == ["581#8000200003000405"]
    rig = begin_upload()
    rig.send("601#A300000000000000")
    assert rig.send("601#A2067F0000000000") == ["581#8008100003000405"]


@pytest.mark.conformance("CiA 301", "CRC of a block (05040004)")
def test_a_wrong_crc_stores_nothing() -> None:
    rig = begin_download()
    send_all(rig, TEXT)
    assert end(rig, TEXT, block_crc(TEXT) ^ 1) == ["581#8000200004000405"]
    assert rig.node.od.upload(0x2000, 0) == b""


@pytest.mark.parametrize(
    ("request_frame", "answer"),
    [
        ("C618100004000000", "8018100002000106"),  # read only comes before too long
        ("C634120004000000", "8034120000000206"),
        ("C600200041000000", "8000200012000706"),  # 65 bytes into 64
        ("A43412007F000000", "8034120000000206"),
        ("A40621067F000000", "8006210600000206"),
        ("A40021067F000000", "8000210601000106"),
        ("C100200000000000", "8000200001000405"),  # the end of no transfer
        ("A100000000000000", "8000000001000405"),
    ],
)
def test_refusals(request_frame: str, answer: str) -> None:
    assert Rig().send(f"601#{request_frame}") == [f"581#{answer}"]


def test_more_and_less_than_announced() -> None:
    rig = begin_download(size=8)
    assert send_all(rig, TEXT[:15]) == ["581#8000200012000706"]
    rig = begin_download(size=20)
    send_all(rig, TEXT[:14])
    assert end(rig, TEXT[:14], block_crc(TEXT[:14])) == ["581#8000200013000706"]


def test_silence_and_abort_end_a_block() -> None:
    rig = begin_download()
    assert rig.wait(1000) == ["581#8000200000000405"]
    rig = begin_download()
    assert rig.send("601#8000200000000008") == []
    assert rig.wait(5000) == []
    rig = begin_upload()
    assert rig.send("601#A200000000000000") == ["581#8008100001000405"]  # not the start


class Wire:
    """canopen's client on one end, the node on the other, no time in between."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.client = SdoClient(0x601, 0x581, ObjectDictionary())
        self.client.network = self

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        for raw in self.rig.node.handle(pack_frame(can_id, bytes(data)), self.rig.now_ns):
            frame = unpack_frame(raw)
            if frame.can_id == 0x581:
                self.client.on_response(frame.can_id, frame.data, 0.0)


@pytest.mark.conformance("CiA 301", "block transfer with CRC, in both directions")
@pytest.mark.parametrize("length", [5, 7, 14, 63, 64])
def test_the_client_of_another_project(length: int) -> None:
    client = Wire(Rig()).client
    with client.open(0x2000, 0, "wb", size=length, block_transfer=True) as file:
        file.write(TEXT[:length])
    with client.open(0x2000, 0, "rb", block_transfer=True) as file:
        assert file.read() == TEXT[:length]
    with client.open(0x1008, 0, "rb", block_transfer=True) as file:
        assert file.read() == NAME
    assert client.upload(0x2000, 0) == TEXT[:length]  # in segments
