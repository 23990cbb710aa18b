"""The row: layout without padding, names with their units."""

from __future__ import annotations

import re

from fffo_drive.signals import ROW, SIGNALS
from fffo_drive.units import SUFFIXES


def test_the_row_has_no_padding_and_every_field_is_aligned():
    offset = 0
    for name in ROW.names:
        dtype, at = ROW.fields[name][:2]
        assert at == offset
        assert at % dtype.itemsize == 0
        offset += dtype.itemsize
    assert ROW.itemsize == offset
    assert ROW.itemsize % 8 == 0


def test_a_signal_with_a_unit_carries_it_in_its_name():
    by_unit = {"ns": "ns", "rps": "rps", "rps2": "rps2", "rev": "rev", "A": "a", "Nm": "nm", "Nm/s": "nm_per_s"}
    for signal in SIGNALS:
        if signal.unit in by_unit:
            assert signal.name.endswith("_" + by_unit[signal.unit]), signal.name
            assert by_unit[signal.unit] in SUFFIXES
        assert re.fullmatch(r"[a-z][a-z0-9_]*", signal.name)
        assert len(signal.meaning) > 3
