"""Linux's CAN tools beside the loop: candump's log of a whole run, cangen's load and garbage, cansend's oddities."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from needs import VCAN
from uml.whole_run import record, reset_node

pytestmark = [pytest.mark.slow, pytest.mark.realtime, pytest.mark.can_utils]
only_vcan = pytest.mark.parametrize("drive_bus", [pytest.param("vcan", marks=pytest.mark.vcan)], indirect=True)

RUN_S = 0.1
ODDITIES = (
    "000# 000#01 000#0101010101 000#FF01 080#0102030405060708 081#1122 080#R 7E5#0401 701#R 77F# 1FFFFFFF#00 "
    "601# 601#22 601#R 601#2F60600000000000 601#FFFFFFFFFFFFFFFF 181#0000000000000000 "
    "201# 201#0F 201#0F00E803000000 00000201#0F00E803"
)


def tool(*words: str) -> None:
    subprocess.run(words, check=True)


@contextmanager
def candump(path) -> Iterator[None]:
    """candump -L of everything, into a file."""
    with path.open("wb") as file:
        process = subprocess.Popen(["candump", "-L", "-D", f"{VCAN},0:0,#FFFFFFFF"], stdout=file)
        try:
            while not path.stat().st_size:  # until it listens
                tool("cansend", VCAN, "7E5#00")
            yield
        finally:
            process.terminate()
            process.wait()


@only_vcan
def test_candump_has_the_whole_run_frame_by_frame(drive_bus, tmp_path):
    with candump(tmp_path / "run.log"):
        whole = record(drive_bus, tmp_path, RUN_S)
    lines = (tmp_path / "run.log").read_text().splitlines()
    assert all(re.fullmatch(rf"\(\d+\.\d{{6}}\) {VCAN} [0-9A-F]{{3,8}}#[0-9A-FR]*", line) for line in lines)
    logged = [line.split()[2] for line in lines]
    ours = whole.texts()
    logged, ours = (texts[texts.index("000#8201") :] for texts in (logged, ours))
    assert logged[-1] == "000#8001" or len(logged) > ours.index("000#8001")
    common = min(len(logged), len(ours))  # both end when they are told, among heartbeats
    assert common > 4 * 200
    assert logged[:common] == ours[:common]


@only_vcan
def test_a_run_bears_the_load_of_others(drive_bus, tmp_path):
    load = subprocess.Popen(["cangen", "-g", "2", "-I", "5A5", "-L", "8", "-i", VCAN])
    try:
        whole = record(drive_bus, tmp_path, RUN_S)
    finally:
        load.terminate()
        load.wait()
    assert whole.outcome.fault_text is None
    assert sum(text.startswith("5A5#") for text in whole.texts()) > 100
    assert whole.outcome.exchange.bad_frames == 0
    assert whole.outcome.exchange.dropped_frames == 0


@only_vcan
def test_garbage_neither_ends_nor_enables_the_drive(drive_bus, tmp_path):
    for words in (["-e"], ["-R"], ["-e", "-R"], []):
        tool("cangen", "-g", "0", "-n", "1000", "-p", "100", "-I", "r", "-L", "r", "-D", "r", *words, VCAN)
    for frame in ODDITIES.split():
        tool("cansend", VCAN, frame)
    reset_node(drive_bus)
    whole = record(drive_bus, tmp_path, RUN_S)
    assert whole.outcome.fault_text is None
