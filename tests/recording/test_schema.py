"""The row as a message: schema, layout and events."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fffo_drive.recording.errors import RecordingError
from fffo_drive.recording.events import EVENT_SCHEMA, Event, Level, decode_event, encode_event
from fffo_drive.recording.schema import layout_from_schema, schema_text
from fffo_drive.signals import ROW, SIGNALS, UNITS, Signal

NUMBERS = ["u1", "<u2", "<u4", "<u8", "i1", "<i2", "<i4", "<i8", "<f4", "<f8"]


def test_schema_of_the_row_gives_the_row_back():
    layout = layout_from_schema(schema_text())
    assert layout.dtype == ROW
    assert layout.units == UNITS
    assert layout.meanings == {signal.name: " ".join(signal.meaning.split()) for signal in SIGNALS}


def test_row_needs_no_padding_in_cdr():
    for name in ROW.names:
        field, offset = ROW.fields[name]
        assert offset % field.itemsize == 0, f"{name}: CDR would put padding in front of it"


@given(st.lists(st.sampled_from(NUMBERS), min_size=1, max_size=20))
def test_any_flat_row_is_aligned_as_a_c_struct(kinds):
    signals = [Signal(f"f{i}", kind, "m/s", "a # b [c] = d") for i, kind in enumerate(kinds)]
    layout = layout_from_schema(schema_text(signals))
    aligned = np.dtype([(f"f{i}", kind) for i, kind in enumerate(kinds)], align=True)
    assert [layout.dtype.fields[n][1] for n in layout.dtype.names] == [aligned.fields[n][1] for n in aligned.names]
    assert set(layout.units.values()) == {"m/s"}
    assert set(layout.meanings.values()) == {"a # b [c] = d"}


def test_foreign_schema_with_constants_arrays_and_nested_definitions():
    text = """
# comment
uint8 MODE_OFF=0
bool on
float64[3] force   # newton
builtin char # 'char' without unit
===
MSG: other/Thing
string s
"""
    layout = layout_from_schema(text.replace("builtin char", "char letter"))
    assert layout.dtype.names == ("on", "force", "letter")
    assert layout.dtype["force"].shape == (3,)
    assert layout.dtype.fields["force"][1] == 8
    assert layout.units == {"on": "-", "force": "-", "letter": "-"}
    assert layout.meanings["force"] == "newton"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("float64 a\nstring b", "line 2: 'string b' is no number"),
        ("float64[] a", "line 1"),
        ("std_msgs/Header header", "line 1"),
        ("float64", "line 1: cannot read"),
        ("float64 a\nfloat32 a", "twice"),
    ],
)
def test_what_has_no_fixed_place_is_named(text, message):
    with pytest.raises(RecordingError, match=message):
        layout_from_schema(text)


def test_signal_type_without_counterpart():
    with pytest.raises(RecordingError, match="signal z"):
        schema_text([Signal("z", "<c16", "-", "complex")])


texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=30)
plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | texts,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(texts, inner, max_size=3),
    max_leaves=8,
)


@given(
    time_ns=st.integers(0, 2**64 - 1),
    level=st.sampled_from(Level),
    source=texts,
    text=texts,
    data=st.dictionaries(texts, plain, max_size=4),
)
def test_events_come_back(time_ns, level, source, text, data):
    event = Event(time_ns, level, source, text, data)
    assert decode_event(encode_event(event)) == event


@given(st.binary(max_size=60))
def test_bytes_that_are_no_event(payload):
    with contextlib.suppress(ValueError):
        assert isinstance(decode_event(payload), Event)


@given(st.integers(0, 200))
def test_events_that_are_cut_off(length):
    payload = encode_event(Event(1, Level.INFO, "loop", "trip", {"code": 3}))
    if length < len(payload):
        with pytest.raises(ValueError):
            decode_event(payload[:length])


def test_event_data_in_terms_of_json():
    data = {"a": np.float64(1.5), "b": np.arange(3), "c": float("nan"), "d": {1: (2, object)}}
    event = decode_event(encode_event(Event(1_700_000_000_000_000_123, 20, "s", "t", data)))
    assert event.data["a"] == 1.5
    assert event.data["b"] == [0, 1, 2]
    assert event.data["c"] == "nan"
    assert event.time == "2023-11-14T22:13:20.000000123Z"
    assert event.as_dict()["level"] == "info"
    assert event.data["d"] == {"1": [2, str(object)]}


def test_events_are_no_rows():
    with pytest.raises(RecordingError, match="string source"):
        layout_from_schema(EVENT_SCHEMA)
