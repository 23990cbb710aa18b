"""The SDO server in frames: expedited and segmented transfer, every abort code, time-out."""

from __future__ import annotations

import pytest
from node.node_rig import Rig


@pytest.mark.conformance("CiA 301", "expedited transfer")
def test_expedited_upload_and_download() -> None:
    Rig().script("""
        > 601#4000100000000000
        < 581#4300100092010200  ; device type
        > 601#4001100000000000
        < 581#4F01100000000000  ; error register, one byte
        > 601#2B17100064000000
        < 581#6017100000000000
        > 601#4017100000000000
        < 581#4B17100064000000
        + 0
        < 701#7F
        > 601#22171000E8030000  ; expedited, size not indicated: the object's length counts
        < 581#6017100000000000
        > 601#4017100000000000
        < 581#4B171000E8030000
        + 0
        < 701#7F
    """)


@pytest.mark.conformance("CiA 301", "segmented transfer", "names and versions 0x1008 to 0x100A")
def test_segmented_upload_of_the_software_version_and_of_a_long_name() -> None:
    Rig().script("""
        > 601#4008100000000000
        < 581#4108100020000000  ; 32 characters
        > 601#6000000000000000
        < 581#006666666F2D6472
        > 601#7000000000000000
        < 581#106976652073696D
        > 601#6000000000000000
        < 581#00756C6174656420
        > 601#7000000000000000
        < 581#10736572766F2064
        > 601#6000000000000000
        < 581#0772697665000000
    """)


@pytest.mark.conformance("CiA 301", "segmented transfer")
def test_segmented_download_of_a_text() -> None:
    rig = Rig()
    rig.script("""
        > 601#210020000A000000
        < 581#6000200000000000
        > 601#0048656C6C6F2C20
        < 581#2000000000000000
        > 601#196178730000 0000
        < 581#3000000000000000
    """)
    assert rig.node.od.upload(0x2000, 0) == b"Hello, axs"


@pytest.mark.conformance("CiA 301", "download without a size, expedited and segmented")
def test_segmented_download_of_a_number_without_a_size() -> None:
    Rig().script("""
        > 601#2006100000000000
        < 581#6006100000000000
        > 601#07F4010000000000
        < 581#2000000000000000
        > 601#4006100000000000
        < 581#43061000F4010000
    """)


@pytest.mark.parametrize(
    ("request_frame", "answer"),
    [
        ("2300100000000000", "8000100002000106"),  # read only: 06010002
        ("4000210600000000", "8000210601000106"),  # write only: 06010001
        ("4018100900000000", "8018100911000906"),  # no such sub-index: 06090011
        ("4034120000000000", "8034120000000206"),  # no such object: 06020000
        ("E000100000000000", "8000100001000405"),  # unknown command: 05040001
        ("A100100000000000", "8000100001000405"),  # the end of no block transfer
        ("2317100000000000", "8017100012000706"),  # too long: 06070012
        ("2F17100000000000", "8017100013000706"),  # too short: 06070013
        ("2F191000F1000000", "8019100031000906"),  # above the range: 06090031
        ("2BC2600100000000", "80C2600112000706"),  # too long comes before the range
        ("2FC2600100000000", "80C2600132000906"),  # below the range: 06090032
        ("4003100100000000", "8003100124000008"),  # history empty: 08000024
        ("2F60600001000000", "8060600030000906"),  # unsupported mode: 06090030
        ("2310100100000000", "8010100120000008"),  # no signature: 08000020
        ("2017100005000000", "6017100000000000"),  # segmented begins without a look at the size
        ("2117100005000000", "8017100012000706"),  # with one: too long
        ("0000000000000000", "8000000001000405"),  # segment of no transfer
        ("6000000000000000", "8000000001000405"),
    ],
)
@pytest.mark.conformance(
    "CiA 301",
    "unknown command specifier (05040001)",
    "read of a write-only object (06010001)",
    "write to a read-only object (06010002)",
    "no such object (06020000)",
    "no such sub-index (06090011)",
    "data too long (06070012)",
    "data too short (06070013)",
    "value not allowed (06090030)",
    "value too high (06090031)",
    "value too low (06090032)",
    "no data (08000024)",
)
def test_abort_codes(request_frame: str, answer: str) -> None:
    assert Rig().send(f"601#{request_frame}") == [f"581#{answer}"]


@pytest.mark.conformance("CiA 301", "toggle bit (05030000)")
def test_toggle_bit_is_checked_in_both_directions() -> None:
    Rig().script("""
        > 601#4008100000000000
        < 581#4108100020000000
        > 601#7000000000000000
        < 581#8008100000000305  ; 05030000
        > 601#6000000000000000
        < 581#8000000001000405  ; the transfer is over
        > 601#210020000A000000
        < 581#6000200000000000
        > 601#1048656C6C6F2C20
        < 581#8000200000000305
    """)


def test_more_or_less_data_than_announced() -> None:
    Rig().script("""
        > 601#210020000A000000
        < 581#6000200000000000
        > 601#0148656C6C6F2C20  ; the last one already
        < 581#8000200013000706
        > 601#2100200008000000
        < 581#6000200000000000
        > 601#0048656C6C6F2C20
        < 581#2000000000000000
        > 601#1048656C6C6F2C20
        < 581#8000200012000706
    """)


@pytest.mark.conformance("CiA 301", "time-out (05040000)")
def test_silence_in_the_middle_of_a_transfer_times_out() -> None:
    Rig().script("""
        > 601#4008100000000000
        < 581#4108100020000000
        + 999
        > 601#6000000000000000
        < 581#006666666F2D6472
        + 999
        + 1
        < 581#8008100000000405  ; 05040000
        + 5000
    """)


def test_abort_by_the_client_ends_the_transfer_without_an_answer() -> None:
    Rig().script("""
        > 601#4008100000000000
        < 581#4108100020000000
        > 601#8008100000000008
        + 5000
        > 601#6000000000000000
        < 581#8000000001000405
    """)


@pytest.mark.conformance("CiA 301", "requests shorter than 8 bytes are ignored")
def test_short_frames_and_other_nodes_requests_are_no_sdo() -> None:
    rig = Rig()
    assert rig.send("601#40001000") == []
    assert rig.send("602#4000100000000000") == []


def test_stopping_the_node_drops_the_transfer() -> None:
    Rig().script("""
        > 601#4008100000000000
        < 581#4108100020000000
        > 000#0201
        + 2000
        > 000#8001
        > 601#6000000000000000
        < 581#8000000001000405
    """)
