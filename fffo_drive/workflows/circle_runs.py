"""The runs of a circle: each complete, at a rate that the machine keeps.

A run counts if nearly all of its ticks ran and were answered. If a busy machine spoiled it, it is repeated; if that one
is spoiled too, all runs of the circle are repeated at a lower rate, so that they can be compared. This is done on the
simulated drive alone, with wider limits on missing feedback. On hardware rate and limits are those of the file, and a
spoiled run is an error.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from ..config.axis import AxisFile, model_of, read_axis, rebased, with_keys
from ..config.commissioning import permission
from ..config.drive_section import CanopenDriveSection
from ..documents import DocumentError, parse, read_text
from ..drive.port import DriveError
from ..evaluation.metrics import Rows
from ..identification.gaps import LONGEST_FILL_S
from ..runtime.runs import RunOutcome, simulated_ring_rows
from .errors import DriveFaultError, RecordingGapError
from .plan import Plan, checked_plan, open_drive
from .progress import Bar, no_bar
from .record import record_run
from .recordings import claim, recorded_rows

LOWER_RATES_HZ = (1000, 500)
TRIES = 2  # at one rate
MOST_LOST = 0.05  # share of the ticks that were skipped or had no answer
LEAST_WHOLE = 0.7  # share of the time in stretches that a diagnosis can use
WHOLE_S = 2.0
STALL_S = 0.02  # after a stall of this length a trip counts as caused by the machine
SPARE_RING_S = 20.0  # of rows, for a machine that is slow to enable and to stop

# limits of a simulated drive on a bus that tolerate a slow host; key -> least value
PATIENT_DRIVE = {"heartbeat_timeout_ms": 5000, "command_timeout_ms": 5000}
PATIENT_LIMITS = {"heartbeat_timeout_s": 10.0, "following_error_s": 1.0}
PATIENT_S = {"feedback_missing_ticks": 2.0, "status_missing_ticks": 4.0}  # in seconds
PATIENT_NODE = {"sync_loss_tolerance_ms": 5000}


class CircleWish(NamedTuple):
    """How the runs of a circle are made; by default as the axis file says."""

    sim: Path | None = None  # file of a simulated drive of its own, in process or on the bus
    bus: str | None = None  # instead of the file's
    rate_hz: int | None = None  # instead of the file's
    uncommissioned: bool = False  # enable a drive on a bus without its record


class SpoiledRunError(Exception):
    """A run that cannot be used because the machine did not keep time."""


class Health(NamedTuple):
    """Timing of a run."""

    ticks: int
    skipped: int
    unanswered: int
    longest_s: float  # between two answers
    whole_share: float  # of the time in stretches of WHOLE_S without a gap that cannot be filled

    @property
    def lost_share(self) -> float:
        """Ticks that were skipped or had no answer."""
        return (self.skipped + self.unanswered) / max(1, self.ticks + self.skipped)

    @property
    def sound(self) -> bool:
        """The run can be used."""
        return self.lost_share <= MOST_LOST and self.whole_share >= LEAST_WHOLE

    @property
    def text(self) -> str:
        """For people."""
        return (
            f"{100.0 * self.lost_share:.1f} % of the ticks skipped or without feedback, the longest silence "
            f"{1e3 * self.longest_s:.0f} ms"
        )


class RecordedRun(NamedTuple):
    """One recorded run."""

    path: Path
    rate_hz: int
    samples: int
    rows: Rows
    health: Health


class Circle:
    """The circle's own axis file in its directory, and the runs with it."""

    def __init__(self, wish: CircleWish, own_path: Path, say: Callable[[str], None], bar: Bar = no_bar) -> None:
        """`say` gets messages, also why a run is repeated; `bar` shows the progress of a run."""
        self.path, self.out = own_path, own_path.parent
        self.say = say
        self._wish, self._bar = wish, bar

    @property
    def axis(self) -> AxisFile:
        """The present axis file."""
        return read_axis(self.path)

    @property
    def forgiving(self) -> bool:
        """A simulated drive on a bus: a spoiled run may be made again, at another rate too."""
        return self._wish.sim is not None and isinstance(self.axis.drive, CanopenDriveSection)

    def rates(self) -> list[int]:
        """Loop rates to try, the file's first, if the law keeps its margins at them."""
        own = self.axis.loop.rate_hz
        lower = [rate for rate in LOWER_RATES_HZ if rate < own] if self.forgiving and not self._wish.rate_hz else []
        return [own, *(rate for rate in lower if self._proven(rate))]

    def set_rate(self, rate_hz: int) -> None:
        """The rate of the runs from now on."""
        change(self.path, ("loop", "rate_hz"), rate_hz)
        if self.forgiving:
            now = {name: getattr(self.axis.envelope, name) or 0 for name in PATIENT_S}
            for name, seconds in PATIENT_S.items():
                change(self.path, ("envelope", name), max(int(seconds * rate_hz), now[name]))

    def _proven(self, rate_hz: int) -> bool:
        axis = with_keys(self.axis, {"loop.rate_hz": rate_hz}, "loop")
        try:
            checked_plan(self.path, axis, model_of(self.path, axis))
        except DocumentError as error:
            self.say(f"not at {rate_hz} Hz: {str(error).splitlines()[0]}")
            return False
        return True

    def at_a_rate_it_keeps(self, runs: Callable[[], tuple[RecordedRun, ...]]) -> tuple[RecordedRun, ...]:
        """All of the runs at one rate. Raises SpoiledRunError when the machine keeps none."""
        rates = self.rates()
        for place, rate in enumerate(rates):
            self.set_rate(rate)
            try:
                return runs()
            except SpoiledRunError as error:
                if place + 1 == len(rates):
                    raise
                self.say(f"{error}: all runs again at {rates[place + 1]} Hz")
        raise AssertionError("no rate")

    def run(self, name: str, profile: Mapping[str, Any] | None = None) -> RecordedRun:
        """One run with the axis file as it is now, or with another profile, into NAME.mcap.

        Raises SpoiledRunError, DriveFaultError, RecordingGapError, DriveError.
        """
        axis = self.axis
        if profile is not None:
            axis = with_keys(axis, {"profile": dict(profile)}, "profile")
        plan = checked_plan(self.path, axis, model_of(self.path, axis))
        tries = TRIES if self.forgiving else 1
        for number in range(1, tries + 1):
            try:
                return self._once(name, plan)
            except SpoiledRunError as error:
                if number == tries:
                    raise
                self.say(f"{error}: once more")
        raise AssertionError("no try")

    def _once(self, name: str, plan: Plan) -> RecordedRun:
        path = self.out / f"{name}.mcap"
        if path.exists():
            _put_aside(path)  # of a spoiled run
        claim(path)
        uncommissioned = self._wish.uncommissioned or self._wish.sim is not None
        given = permission(plan.path, plan.axis, plan.model, uncommissioned)
        ring_rows = simulated_ring_rows(plan.profile, plan.axis.loop.tail_s, SPARE_RING_S)
        drive = open_drive(plan, self._wish.bus)
        try:
            outcome = record_run(plan, drive, plan.toggle, path, given, self._bar, ring_rows)
        except DriveError as error:
            if self.forgiving:
                raise SpoiledRunError(f"{name}: {error}") from error
            raise
        rows = recorded_rows(outcome.files)
        health = health_of(rows, plan.profile.period_s)
        self._require(name, outcome, health)
        return RecordedRun(path, plan.axis.loop.rate_hz, plan.profile.values.size, rows, health)

    def _require(self, name: str, outcome: RunOutcome, health: Health) -> None:
        """Raise the error of a run that cannot be used."""
        if outcome.fault_text is not None:
            at_fault = not outcome.started or not health.sound or health.longest_s > STALL_S
            if self.forgiving and at_fault:
                raise SpoiledRunError(f"{name}: {outcome.fault_text} ({health.text})")
            raise DriveFaultError(f"{name}: {outcome.fault_text}; the recording is in {outcome.files[-1]}")
        if outcome.gap_text is not None:
            if self.forgiving and not outcome.recorder.write_errors:
                raise SpoiledRunError(f"{name}: {outcome.gap_text}")
            raise RecordingGapError(f"{name}: {outcome.gap_text}")
        if not health.sound:
            raise SpoiledRunError(f"{name}: {health.text}")


def health_of(rows: Rows, period_s: float) -> Health:
    """Timing from the first tick with torque to the last."""
    acting = np.flatnonzero(rows["mode"] != 0)
    if not acting.size:
        return Health(0, 0, 0, 0.0, 0.0)
    rows = rows[acting[0] : acting[-1] + 1]
    tick = rows["tick"].astype(np.int64)
    fresh = tick[rows["velocity_age"] == 0]
    due = int(tick[-1] - tick[0]) + 1
    if fresh.size < 2:
        return Health(rows.size, due - rows.size, rows.size, due * period_s, 0.0)
    steps = np.diff(fresh)
    edges = np.concatenate([[0], np.flatnonzero(steps * period_s > LONGEST_FILL_S) + 1, [fresh.size]])
    lengths = fresh[edges[1:] - 1] - fresh[edges[:-1]] + 1
    whole = int(lengths[lengths * period_s >= min(WHOLE_S, 0.5 * due * period_s)].sum())
    return Health(rows.size, due - rows.size, rows.size - fresh.size, float(steps.max()) * period_s, whole / due)


def _put_aside(path: Path) -> None:
    """Keep a spoiled record under another name."""
    number = 1
    while path.with_name(f"{path.stem}_spoiled_{number}.mcap").exists():
        number += 1
    path.rename(path.with_name(f"{path.stem}_spoiled_{number}.mcap"))


# -- files ----------------------------------------------------------------------------------------------------------


def change(path: Path, key: tuple[str, ...], value: Any) -> None:
    """Set one key of a YAML file."""
    data, _ = parse(read_text(path), str(path))
    section = data
    for part in key[:-1]:
        section = section.setdefault(part, {})
    section[key[-1]] = value
    write_yaml(path, data)


def write_yaml(path: Path, data: Any) -> Path:
    """A YAML file. Returns its path."""
    path.write_text(yaml.safe_dump(data, sort_keys=False, width=110), encoding="utf-8")
    return path


def write_axis(axis_path: Path, out: Path, sim: Path | None, rate_hz: int | None) -> Path:
    """A copy of the axis file in DIR with paths from there, and without the monitor, which would switch effects.

    The file of a given simulated drive replaces that of an axis in process; on a bus the limits are widened.
    """
    axis = read_axis(axis_path)
    data, _ = parse(read_text(axis_path), str(axis_path))
    data = rebased(data, axis_path, out)
    data["controller"].setdefault("effects", {})["monitor"] = False
    if rate_hz is not None:
        data.setdefault("loop", {})["rate_hz"] = rate_hz
    if sim is not None and not isinstance(axis.drive, CanopenDriveSection):
        data["drive"]["file"] = str(sim.resolve())
    elif sim is not None:
        _raise(data["drive"], PATIENT_DRIVE, axis.drive)
        _raise(data["envelope"], PATIENT_LIMITS, axis.envelope)
        data["envelope"]["accept_runaway"] = True  # it is a simulated drive, and PATIENT_S is beyond any machine
        data.setdefault("realtime", {})["required"] = False
    path = write_yaml(out / "axis.yaml", data)
    read_axis(path)
    return path


def write_simulated(sim: Path, out: Path) -> Path:
    """A copy of the simulated drive's file that tolerates stalls of the host."""
    data, _ = parse(read_text(sim), str(sim))
    for name, least in PATIENT_NODE.items():
        data[name] = max(least, int(data.get(name, 0)))
    return write_yaml(out / "simulated.yaml", data)


def _raise(section: dict[str, Any], least: Mapping[str, float], now: object) -> None:
    for name, value in least.items():
        section[name] = max(value, getattr(now, name))
