"""Arrays and frames become records like files."""

from __future__ import annotations

import numpy as np
import pytest
from importing.axis_log import truth

from fffo_drive.importing.frames import record_of
from fffo_drive.importing.recognise import Hints
from fffo_drive.recording.errors import RecordingError


class Column:
    """What pandas and polars have in common."""

    def __init__(self, values):
        self.values = values

    def to_numpy(self):
        return self.values


class Frame:
    def __init__(self, columns):
        self._columns = columns

    @property
    def columns(self):
        return list(self._columns)

    def __getitem__(self, name):
        return Column(self._columns[name])


def columns():
    log = truth()
    return {
        "time_ms": 1e3 * log.time_s, "angle [deg]": 360.0 * log.position_rev, "speed_rpm": 60.0 * log.velocity_rps,
        "iq": log.current_a,
    }  # fmt: skip


@pytest.mark.parametrize("kind", [dict, Frame])
def test_a_frame_gives_the_record_of_its_numbers(kind):
    record, facts, found = record_of(kind(columns()), name="bench", torque_constant_nm_per_a=0.13, pole_pairs=4)
    log = truth()
    assert record.period_s == pytest.approx(2e-3)
    assert facts.pole_pairs == 4
    np.testing.assert_allclose(record.position_rev, log.position_rev, atol=1e-9)
    np.testing.assert_allclose(record.velocity_rps, log.velocity_rps, atol=1e-9)
    np.testing.assert_allclose(record.current_a, log.current_a)
    assert found.of("current_a").column == "iq"
    assert any("stands in" in warning for warning in record.warnings)


def test_dates_are_seconds_and_lists_will_do():
    log = truth()
    given = columns() | {"time_ms": np.datetime64("2026-01-01") + (1e9 * log.time_s).astype("timedelta64[ns]")}
    given = {"stamp" if name == "time_ms" else name: values for name, values in given.items()}
    given["iq"] = given["iq"].tolist()
    record, _, _ = record_of(given)
    np.testing.assert_allclose(record.position_rev, log.position_rev, atol=1e-6)


def test_what_cannot_be_determined_is_an_error_and_a_hint_mends_it():
    given = {f"x{k}": values for k, values in enumerate(columns().values())}
    given["x3"] = np.random.default_rng(1).normal(size=given["x0"].size)
    with pytest.raises(RecordingError, match="no current or torque"):
        record_of(given)
    _, _, found = record_of(given, hints=Hints(roles={"current_command_a": "x3"}))
    assert found.of("current_command_a").column == "x3"
