"""The reading end of the ring: every row once, or counted as lost."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recording.samples import FakeRing, random_rows, same_bits

from fffo_drive.recording.ring_reader import RingReader

ROWS = random_rows(4000)


@given(
    capacity=st.sampled_from([2, 4, 16, 64]),
    bursts=st.lists(st.integers(0, 100), max_size=30),
)
def test_every_row_is_read_or_counted(capacity, bursts):
    ring = FakeRing(capacity)
    reader = RingReader(ring)
    written = 0
    for burst in bursts:
        ring.push(ROWS[written : written + burst])
        before, written = written, written + burst
        batch = reader.read()
        # the writer may be filling the slot of the oldest row: one row less than the capacity is safe
        assert batch.lost == max(0, burst - (capacity - 1))
        assert same_bits(batch.rows, ROWS[before + batch.lost : written])
        assert reader.rows_read + reader.rows_lost == written
    assert reader.read().rows.size == 0


@given(during=st.integers(0, 40), waiting=st.integers(0, 15))
def test_rows_overwritten_while_they_are_copied_are_not_delivered(during, waiting):
    """The writer goes on between the copy and the second look at the head."""
    ring = FakeRing(16)
    reader = RingReader(ring)
    ring.push(ROWS[:waiting])
    copy = reader._copy

    def copy_beside_the_writer(first: int, head: int) -> np.ndarray:
        ring.push(ROWS[waiting : waiting + during // 2])
        copied = copy(first, head)
        ring.push(ROWS[waiting + during // 2 : waiting + during])
        return copied

    reader._copy = copy_beside_the_writer
    batch = reader.read()
    ticks = batch.rows["tick"].tolist()
    assert ticks == list(range(batch.lost, waiting))
    assert same_bits(batch.rows, ROWS[batch.lost : waiting])
    assert batch.lost == min(waiting, max(0, waiting + during - 15))
    reader._copy = copy
    rest = reader.read()
    assert reader.rows_read + reader.rows_lost == waiting + during
    assert rest.rows["tick"].tolist() == list(range(max(waiting, waiting + during - 15), waiting + during))


@pytest.mark.parametrize("newest", [0, 1])
@pytest.mark.parametrize("written", [0, 1, 20])
def test_beginning_with_the_newest_rows(written, newest):
    ring = FakeRing(8)
    ring.push(ROWS[:written])
    reader = RingReader(ring, newest=newest)
    ring.push(ROWS[written : written + 3])
    assert reader.read().rows["tick"].tolist() == list(range(max(written - newest, 0), written + 3))
    assert reader.rows_lost == 0


@pytest.mark.parametrize("capacity", [0, 1, 3, 12])
def test_capacity_must_be_a_power_of_two(capacity):
    with pytest.raises(ValueError, match="power of two"):
        RingReader(FakeRing(capacity))
