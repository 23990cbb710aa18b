"""Decimation keeps every extreme, captures are the rows bit for bit, and nothing is read while nobody listens."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from live.ring_writer import rows_of, write
from live.scope_rig import taken_apart

from fffo_drive.live import frames
from fffo_drive.live.decimation import (
    LAST,
    LATENESS_EDGES_US,
    MAXIMUM,
    MINIMUM,
    Decimator,
    as_matrix,
    bin_ticks_of,
    lateness_counts,
)
from fffo_drive.live.feed import CAPTURE_S, Capture, Feed, FeedSource
from fffo_drive.runtime.ring import new_ring
from fffo_drive.signals import ROW, SIGNALS

NAMES = [signal.name for signal in SIGNALS]


@given(
    cuts=st.lists(st.integers(0, 200), max_size=8), first=st.integers(0, 90), bin_ticks=st.integers(1, 50),
    missing=st.sets(st.integers(0, 199), max_size=60),
)  # fmt: skip
@settings(max_examples=15, derandomize=True)
def test_however_rows_come_each_whole_bin_has_the_extremes_of_its_ticks(cuts, first, bin_ticks, missing):
    rows = rows_of(first, 200)[[i for i in range(200) if i not in missing]]
    decimator = Decimator(bin_ticks)
    places = [0, *sorted(min(cut, len(rows)) for cut in cuts), len(rows)]
    bins = np.concatenate([decimator.feed(rows[a:b]) for a, b in pairwise(places)])
    numbers = rows["tick"] // bin_ticks
    begun = list(dict.fromkeys(numbers))
    expected = begun if (rows["tick"][-1] + 1) % bin_ticks == 0 else begun[:-1]
    assert len(bins) == len(expected)
    for got, number in zip(bins, expected, strict=True):
        inside = as_matrix(rows[numbers == number])
        np.testing.assert_array_equal(got[:, LAST], inside[-1])
        finite = ~np.isnan(inside).all(axis=0)
        np.testing.assert_array_equal(got[finite, MINIMUM], inside[:, finite].min(axis=0))
        np.testing.assert_array_equal(got[finite, MAXIMUM], inside[:, finite].max(axis=0))
        assert np.isnan(got[~finite]).all()


def test_one_row_in_a_bin_is_seen_through_its_extremes():
    rows = rows_of(0, 40)
    rows["error_rps"], rows["trip"] = 0.0, 0
    rows["error_rps"][17], rows["trip"][18] = -3.5, 4
    (bin_,) = Decimator(40).feed(rows)
    assert bin_[NAMES.index("error_rps")].tolist() == [-3.5, 0.0, 0.0]
    assert bin_[NAMES.index("trip")].tolist() == [0.0, 4.0, 0.0]


def test_every_tick_is_in_one_bin_of_the_lateness():
    rows = rows_of(0, 1000)
    rows["lateness_ns"][:3] = 0, 1000, 1001
    counts = lateness_counts(rows)
    assert counts.sum() == 1000
    assert len(counts) == len(LATENESS_EDGES_US) + 1
    assert lateness_counts(rows[:3]).tolist()[:2] == [2, 1]
    assert counts[-1] == np.count_nonzero(rows["lateness_ns"] > LATENESS_EDGES_US[-1] * 1000)


@pytest.mark.parametrize(("rate_hz", "ticks"), [(2000.0, 40), (500.0, 10), (50.0, 1), (10.0, 1)])
def test_bins_are_fifty_a_second(rate_hz, ticks):
    assert bin_ticks_of(rate_hz) == ticks


def test_a_capture_is_the_newest_rows_bit_for_bit():
    capture, rows = Capture(250), rows_of(0, 1000)
    for begin in range(0, 1000, 70):
        capture.add(rows[begin : begin + 70])
    assert capture.newest(100).tobytes() == rows[-100:].tobytes()
    assert capture.newest(250).tobytes() == rows[-250:].tobytes()
    assert capture.newest(50, 899).tobytes() == rows[850:900].tobytes()  # around an event that is over
    assert len(capture.newest(50, 100)) == 0
    assert len(capture.newest(10_000)) < 250 + 70  # what is older is let go
    assert len(Capture(10).newest(5)) == 0


def test_the_feed_follows_the_loop_and_the_next_one():
    rings = [new_ring(4096), new_ring(4096)]
    write(rings[0], rows_of(0, 64))  # before anybody listened
    sources = [FeedSource(1, rings[0], 2000.0, 0.148)]
    feed = Feed(lambda: sources[0])
    feed.begin()
    assert feed.poll() is None
    rows = rows_of(64, 300)
    write(rings[0], rows)
    head, payload = taken_apart(feed.poll().frame())
    assert (head["kind"], head["loop"], head["ticks"], head["lost"]) == ("rows", 1, 300, 0)
    values = np.frombuffer(payload).reshape(head["bins"], len(SIGNALS), 3)
    assert values[0, NAMES.index("tick"), MINIMUM] == 64
    taken = b"".join(taken_apart(frame)[1] for frame in feed.captured(CAPTURE_S))
    assert taken == rows.tobytes()
    assert (
        np.frombuffer(b"".join(taken_apart(f)[1] for f in feed.captured(0.05)), ROW).tobytes() == rows[-100:].tobytes()
    )
    sources[0] = FeedSource(2, rings[1], 1000.0, 0.148)
    assert feed.poll() is None
    write(rings[1], rows_of(0, 20))
    assert feed.poll().loop == 2


def test_some_signals_of_a_capture_are_their_columns_packed_in_that_order():
    ring = new_ring(4096)
    feed = Feed(lambda: FeedSource(3, ring, 2000.0, 0.148))
    feed.begin()
    feed.poll()
    rows = rows_of(0, 3000)
    write(ring, rows)
    feed.poll()
    names = ["tick", "velocity_rps", "trip"]
    packed = np.dtype([(name, ROW[name]) for name in names])
    parts = [taken_apart(frame) for frame in feed.captured(1.0, 2499, names, 17)]
    assert {(head["id"], head["loop"], head["total"]) for head, _ in parts} == {(17, 3, 2000)}
    assert parts[0][0]["signals"] == names
    taken = np.frombuffer(b"".join(payload for _, payload in parts), packed)
    for name in names:
        np.testing.assert_array_equal(taken[name], rows[name][500:2500])
    assert len(parts) < len(feed.captured(1.0, 2499)) / 4  # some signals cost less than all


def test_nothing_is_kept_while_nobody_listens():
    ring = new_ring(64)
    feed = Feed(lambda: FeedSource(1, ring, 2000.0, 0.1))
    feed.begin()
    feed.poll()
    feed.end()
    write(ring, rows_of(0, 500))
    (frame,) = feed.captured(1.0)
    assert taken_apart(frame)[0]["total"] == 0
    feed.begin()
    assert feed.poll() is None  # from now on, not what was missed


def test_binary_frames_have_their_numbers_on_a_multiple_of_eight():
    for name in ("a", "ab", "abc", "ä" * 9):
        frame = frames.binary("rows", b"12345678", name=name)
        head, payload = taken_apart(frame)
        assert head == {"kind": "rows", "name": name}
        assert payload == b"12345678"
        assert (len(frame) - len(payload)) % 8 == 0


def test_fields_are_the_signals_and_their_places_in_a_row():
    assert [field["name"] for field in frames.fields()] == NAMES
    row = rows_of(7, 1)
    for field in frames.fields():
        size = np.dtype(field["type"]).itemsize
        raw = row.tobytes()[field["offset"] : field["offset"] + size]
        np.testing.assert_array_equal(np.frombuffer(raw, field["type"]), row[field["name"]])
