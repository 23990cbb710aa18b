"""Replay of whole recordings: the files of a daemon's day, with every block that was in use, and the result.

Files are passed in the order in which they were written. Files of one session (by the id in their records) form one
run: after rotation, or recording switched off and on, only the missing rows are lost. A file that begins while the axis
is enabled begins with the memory of the law, so each replays on its own, too.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats, Integers
from ..control.controller import CONTROLLER_BLOCK_SIZE
from ..control.envelope import (
    TRIP_BUS_OFF,
    TRIP_EMERGENCY,
    TRIP_FOREIGN_COMMAND,
    TRIP_NOT_OPERATIONAL,
    TRIP_REBOOT,
    TRIP_TEXTS,
    EnvelopeConfig,
)
from ..control.own_law import ControlLaw
from ..control.reference import MODE_VELOCITY
from ..control.set_point import SET_POINT_SIZE
from ..documents import DocumentError
from ..drive.cia402 import GOAL_DISABLED, GOAL_ENABLED
from ..packing import flat_names, reader
from ..recording.run_records import RecordKind, RunRecord
from ..runtime.records import (
    MemoryBefore,
    block_of,
    effects_of,
    envelope_of,
    memory_before,
    period_s_of,
    set_point_of,
)
from ..runtime.tick import (
    FLAG_BUS_OFF,
    FLAG_EMERGENCY,
    FLAG_FOREIGN_COMMAND,
    FLAG_LOOP_BEGAN,
    FLAG_NOT_OPERATIONAL,
    FLAG_REBOOT,
)
from ..signals import ROW
from .replay import COMMANDS, REQUESTED, TERMS, WORDS, Replay, Replayed, Rows, law_in_force
from .replay_live import LIVE_FIELDS, LiveReplay, LiveRows

FLAG_OF_TRIP = {
    TRIP_EMERGENCY: FLAG_EMERGENCY,
    TRIP_REBOOT: FLAG_REBOOT,
    TRIP_NOT_OPERATIONAL: FLAG_NOT_OPERATIONAL,
    TRIP_BUS_OFF: FLAG_BUS_OFF,
    TRIP_FOREIGN_COMMAND: FLAG_FOREIGN_COMMAND,
}
LIMITED = COMMANDS.index("limited_a")
TRIP = WORDS.index("trip")


class ReplayedLaw(NamedTuple):
    """One law for all rows: a different one than recorded, or that of a recording which does not name its blocks."""

    parameters: Floats  # (CONTROLLER_BLOCK_SIZE,)
    effects: Floats  # (TABLE_SIZE,)
    envelope: EnvelopeConfig


class BlocksUsed(NamedTuple):
    """Rows in which the law acted with the same blocks."""

    session: str
    parameters: int
    effects: int
    model: str  # content hash; empty where it is not known
    rows: int


class ProfilesRun(NamedTuple):
    """Profiles that ran from their first to their last sample."""

    as_asked: int  # their samples in the rows are those of the record, bit for bit
    other: int


class ReplayReport(NamedTuple):
    """Comparison of a replay with its recording."""

    rows: int  # in which the law acted, and was replayed
    identical: int  # of these, every term and the command the same to the last bit
    all_rows: int  # replayed, without torque too
    all_identical: int  # of these, command, limits, I2t heat, fault and controlword too
    not_replayed: int  # rows in which the law acted, with its memory or its blocks not known
    first_difference_tick: int  # -1: none
    first_difference: str  # what differs there
    rms_difference_a: float  # of requested_a
    largest_difference_a: float
    rms_command_difference_a: float  # of limited_a
    trips_elsewhere: int  # rows in which the envelope finds a trip that is not recorded
    first_trip: str  # the first of them, in words
    blocks: list[BlocksUsed]
    profiles: ProfilesRun
    live: LiveRows
    names_blocks: bool  # False: a recording of an older version among them
    torn: tuple[str, ...] = ()  # of each recording that is not whole: where it ends, and the rows kept

    @property
    def exact(self) -> bool:
        """Whether the recording is reproduced completely."""
        made_again = not (self.live.other or self.live.not_followed)
        return self.rows > 0 and self.all_identical == self.all_rows and not self.not_replayed and made_again


class Replayer:
    """Takes recordings one by one, in the order in which they were written."""

    def __init__(self, instead: ReplayedLaw | None = None, controller: ControlLaw | None = None) -> None:
        """`instead`: a law to run on the recorded data instead of those in use; `controller`: that of a user's own, of
        recordings that were made with it.
        """
        self._instead = instead
        self._controller = controller
        self._sessions: dict[str, _Session] = {}
        self._sum = _Sums()

    def take(self, recorded: Rows, records: Iterable[RunRecord], fallback: ReplayedLaw | None = None) -> Replayed:
        """Replay the rows and records of a file. `fallback`: the law of one that does not name its blocks.

        Raises ValueError for a recording that needs one and has none, or whose blocks are of other parameters.
        """
        rows, records = as_current(recorded), tuple(records)
        name = session_id(records)
        names_blocks = "row_number" in (recorded.dtype.names or ())
        if name is not None and names_blocks:
            session = self._sessions.setdefault(name, _Session(name, None, self._controller, self._instead is None))
            session.learn(records)
        else:
            law = self._instead or fallback
            if law is None:
                raise ValueError("it does not name its blocks, and no law is given for it")
            session = _Session("", law)
            self._sum.names_blocks = False
        replayed = session.replay(rows, self._instead)
        self._sum.add(rows, replayed, all_of_it=names_blocks)
        session.follow_profiles(rows, self._sum)
        if name is not None and names_blocks:
            session.follow_set_points(rows, self._sum)
        self._sum.count_blocks(session, rows, replayed)
        return replayed

    @property
    def report(self) -> ReplayReport:
        """Over all recordings so far."""
        return self._sum.report()


def session_id(records: Iterable[RunRecord]) -> str | None:
    """Session of the records; None if they do not name it."""
    for record in records:
        if record.kind == RecordKind.SESSION:
            return str(record.data["session"])
    return None


def as_current(rows: Rows) -> Rows:
    """Rows with the fields of today; those that an older version did not write as far as they follow from the rest.

    Of older rows torque is wanted where the law acts, blocks have number 0 and the memory begins with the first row.
    """
    if rows.dtype == ROW:
        return rows
    made = np.zeros(rows.size, ROW)
    for name in set(rows.dtype.names or ()) & set(ROW.names or ()):
        made[name] = rows[name]
    missing = set(ROW.names or ()) - set(rows.dtype.names or ())
    if "row_number" in missing:
        made["row_number"] = np.arange(rows.size)
    for name in missing & {"heartbeat_age_ns", "set_point_sample", "foreign_id"}:
        made[name] = -1
    if "i2t_a2s" in missing:
        made["i2t_a2s"] = np.nan
    if "goal" in missing:
        made["goal"] = np.where(made["mode"] != 0, GOAL_ENABLED, GOAL_DISABLED)
    if "flags" in missing and rows.size:
        made["flags"][0] = FLAG_LOOP_BEGAN
        for trip, flag in FLAG_OF_TRIP.items():
            made["flags"][made["trip"] == trip] |= flag
    return made


class _Session:
    """Blocks and memory of one session."""

    def __init__(
        self,
        name: str,
        law: ReplayedLaw | None = None,
        controller: ControlLaw | None = None,
        as_recorded: bool = True,
    ) -> None:
        self.name = name
        self._controller = controller
        self._as_recorded = as_recorded
        self._replay = Replay()
        self._envelope = law.envelope if law else None
        self._parameters: list[Floats] = [law.parameters] if law else []
        self._effects: list[Floats] = [law.effects] if law else []
        self._parameters_at: dict[int, int] = {0: 0} if law else {}
        self._effects_at: dict[int, int] = {0: 0} if law else {}
        self.models: dict[int, str] = {}
        self._profiles: dict[int, RunRecord] = {}
        self._playing: _Playing | None = None
        self._live = LiveReplay()
        self._set_points: list[Floats] = []
        self._set_points_at: dict[int, int] = {}
        self._memories: dict[int, MemoryBefore] = {}  # by the number of the row before which each was
        self._period_s = 0.0

    def learn(self, records: tuple[RunRecord, ...]) -> None:
        """Blocks in the records of a file."""
        for record in records:
            if record.kind == RecordKind.SESSION:
                self._envelope = envelope_of(record)
                self._period_s = period_s_of(record)
            elif record.kind == RecordKind.PARAMETERS and record.number not in self._parameters_at:
                self._parameters_at[record.number] = len(self._parameters)
                self._parameters.append(block_of(record))
                self.models[record.number] = str(record.data.get("model", ""))
                if self._as_recorded and "controller" in record.data and record.number == 0:
                    self._replay = Replay(recorded_law(record.data["controller"], self._controller).block())
            elif record.kind == RecordKind.EFFECTS and record.number not in self._effects_at:
                self._effects_at[record.number] = len(self._effects)
                self._effects.append(effects_of(record))
            elif record.kind == RecordKind.SET_POINT and record.number not in self._set_points_at:
                self._set_points_at[record.number] = len(self._set_points)
                self._set_points.append(set_point_of(record))
            elif record.kind == RecordKind.MEMORY:
                self._memories[record.number] = memory_before(record)
            elif record.kind == RecordKind.PROFILE:
                self._profiles[record.number] = record

    def replay(self, rows: Rows, instead: ReplayedLaw | None) -> Replayed:
        """The next rows. Another law takes over from the recorded one with the first row, as by a live change."""
        before = self._memory_before(rows)
        if instead is not None:
            parameters, effects = [instead.parameters], [instead.effects]
            if before is not None:
                parameters.append(self._parameters[self._parameters_at[before.parameters_number]])
                effects.append(self._effects[self._effects_at[before.effects_number]])
                self._replay.begin_from(before, 1, 1)
            nowhere = np.zeros(rows.size, np.int64)
            return self._replay.run(law_in_force(parameters, effects, instead.envelope), rows, nowhere, nowhere)
        assert self._envelope is not None
        if before is not None:
            places = self._parameters_at[before.parameters_number], self._effects_at[before.effects_number]
            self._replay.begin_from(before, *places)
            self._live.begin_from(before)
        law = law_in_force(self._parameters, self._effects, self._envelope)
        return self._replay.run(
            law,
            rows,
            _places(rows["parameters_number"], self._parameters_at),
            _places(rows["effects_number"], self._effects_at),
        )

    def _memory_before(self, rows: Rows) -> MemoryBefore | None:
        """The recorded memory with which these rows begin; None where it is known already, or not recorded."""
        if not rows.size or self._replay.continues_with(rows[0]):
            return None
        before = self._memories.get(int(rows["row_number"][0]))
        known = before is not None and (
            before.parameters_number in self._parameters_at and before.effects_number in self._effects_at
        )
        return before if known else None

    def follow_set_points(self, rows: Rows, sums: _Sums) -> None:
        """Recompute the references of live set points."""
        lives = rows["set_point_sample"] >= 0
        found = self._live.run(
            np.array(self._set_points).reshape(-1, SET_POINT_SIZE),
            np.array(self._parameters).reshape(-1, CONTROLLER_BLOCK_SIZE),
            self._period_s,
            rows,
            _places(rows["set_point_number"], self._set_points_at),
            _places(rows["parameters_number"], self._parameters_at),
        )
        followed = lives & ~np.isnan(found[:, 0])
        same = np.logical_and.reduce([_same_bits(rows[name], found[:, k]) for k, name in enumerate(LIVE_FIELDS)])
        sums.live["as_asked"] += int((followed & same).sum())
        sums.live["other"] += int((followed & ~same).sum())
        sums.live["not_followed"] += int((lives & ~followed).sum())

    def follow_profiles(self, rows: Rows, sums: _Sums) -> None:
        """Compare the samples that ran with the requested profiles."""
        runs = rows["profile_sample"] >= 0
        edges = np.flatnonzero(np.diff(rows["profile_number"], prepend=0) != 0)
        for part in np.split(np.flatnonzero(runs), np.searchsorted(np.flatnonzero(runs), edges)):
            if part.size:
                self._follow(rows[part], sums)

    def _follow(self, rows: Rows, sums: _Sums) -> None:
        number = int(rows["profile_number"][0])
        record = self._profiles.get(number)
        if record is None:
            return
        if self._playing is None or self._playing.number != number:
            self._playing = _Playing(number, int(record.by_name["samples"]))
        digest = self._playing.take(rows)
        if digest is not None:
            sums.profiles["as_asked" if digest == record.data["values_sha256"] else "other"] += 1


def recorded_law(recorded: Mapping[str, Any], law: ControlLaw | None) -> ControlLaw:
    """A user's law with the config that a recording has of it. Raises DocumentError where it is another law."""
    whose = f"it was recorded with the control law {recorded['name']!r} of {recorded['file']}"
    if law is None:
        raise DocumentError(f"controller: {whose}: give it, as fd.replay(run, controller=LAW)")
    numbers = recorded["config"]
    if law.name != recorded["name"] or tuple(numbers) != flat_names(type(law.config)):
        raise DocumentError(f"controller: {whose}, and {law.name!r} of {law.file} has another name or config")
    return replace(law, config=reader(type(law.config), "recorded_config")(list(numbers.values())))


class _Playing:
    """A profile while its rows go by."""

    def __init__(self, number: int, samples: int) -> None:
        self.number = number
        self._samples = samples
        self._next = 0
        self._digest = hashlib.sha256()

    def take(self, rows: Rows) -> str | None:
        """The digest of all samples, once, with the last of them; None before, and where samples are missing."""
        sample = rows["profile_sample"]
        if self._next < 0 or sample[0] != self._next or (np.diff(sample) != 1).any():
            self._next = -1
            return None
        first, self._next = self._next, int(sample[-1]) + 1
        if first >= self._samples:
            return None  # the tail
        part = rows[: self._samples - first]
        values = np.where(part["mode"] == MODE_VELOCITY, part["reference_rps"], part["requested_a"])
        self._digest.update(np.ascontiguousarray(values, "<f8").tobytes())
        return self._digest.hexdigest() if self._next >= self._samples else None


def _places(numbers: Any, places: dict[int, int]) -> Integers:
    """Place of each number; -1 for one that is not known."""
    distinct, back = np.unique(numbers, return_inverse=True)
    found: Integers = np.array([places.get(int(number), -1) for number in distinct], np.int64)[back]
    return found


class _Sums:
    """Data of a report, accumulated file by file."""

    def __init__(self) -> None:
        self.rows = self.identical = self.all_rows = self.all_identical = self.not_replayed = 0
        self.trips_elsewhere = 0
        self.first_tick, self.first_name, self.first_trip = -1, "", ""
        self.squares_a2 = self.command_squares_a2 = self.largest_a = 0.0
        self.blocks: Counter[BlocksUsed] = Counter()
        self.profiles = {"as_asked": 0, "other": 0}
        self.live = dict.fromkeys(LiveRows._fields, 0)
        self.names_blocks = True

    def add(self, rows: Rows, replayed: Replayed, all_of_it: bool) -> None:
        """Add rows and their replay."""
        known = replayed.known == 1
        acts = rows["mode"] == MODE_VELOCITY
        acted = acts & known
        differs: dict[str, Any] = {}
        for k, name in enumerate(TERMS):
            differs[name] = acted & ~_same_bits(rows[name], replayed.terms[:, k])
        if not all_of_it:  # an older version: its rows without torque do not contain enough
            differs["limited_a"] = acted & ~_same_bits(rows["limited_a"], replayed.commands[:, LIMITED])
        else:
            for k, name in enumerate(COMMANDS):
                differs[name] = known & ~_same_bits(rows[name], replayed.commands[:, k])
            for k, name in enumerate(WORDS):
                differs[name] = known & (rows[name].astype(np.int64) != replayed.words[:, k])
        different = np.logical_or.reduce(list(differs.values()))
        self.rows += int(acted.sum())
        self.identical += int((acted & ~different).sum())
        counted = known if all_of_it else acted
        self.all_rows += int(counted.sum())
        self.all_identical += int((counted & ~different).sum())
        self.not_replayed += int((acts & ~known).sum())
        if different.any() and self.first_tick < 0:
            first = int(np.flatnonzero(different)[0])
            self.first_tick = int(rows["tick"][first])
            self.first_name = ", ".join(name for name, where in differs.items() if where[first])
        change_a = (replayed.terms[:, REQUESTED] - rows["requested_a"])[acted]
        self.squares_a2 += float(np.sum(change_a**2))
        self.largest_a = max(self.largest_a, float(np.abs(change_a).max(initial=0.0)))
        self.command_squares_a2 += float(np.sum((replayed.commands[:, LIMITED] - rows["limited_a"])[acted] ** 2))
        elsewhere = known & (replayed.words[:, TRIP] != rows["trip"]) & (replayed.words[:, TRIP] != 0)
        self.trips_elsewhere += int(elsewhere.sum())
        if elsewhere.any() and not self.first_trip:
            first = int(np.flatnonzero(elsewhere)[0])
            self.first_trip = f"tick {rows['tick'][first]}: {TRIP_TEXTS[int(replayed.words[first, TRIP])]}"

    def count_blocks(self, session: _Session, rows: Rows, replayed: Replayed) -> None:
        """Which blocks were in use while the law acted."""
        acted = rows[(rows["mode"] == MODE_VELOCITY) & (replayed.known == 1)]
        pairs, counts = np.unique(
            np.stack((acted["parameters_number"], acted["effects_number"]), axis=1), axis=0, return_counts=True
        )
        for (parameters, effects), count in zip(pairs.tolist(), counts.tolist(), strict=True):
            used = BlocksUsed(session.name, parameters, effects, session.models.get(parameters, ""), 0)
            self.blocks[used] += count

    def report(self) -> ReplayReport:
        """All of it."""
        rows = max(self.rows, 1)
        return ReplayReport(
            self.rows, self.identical, self.all_rows, self.all_identical, self.not_replayed, self.first_tick,
            self.first_name, float(np.sqrt(self.squares_a2 / rows)), self.largest_a,
            float(np.sqrt(self.command_squares_a2 / rows)), self.trips_elsewhere, self.first_trip,
            [used._replace(rows=count) for used, count in self.blocks.items()],
            ProfilesRun(**self.profiles), LiveRows(**self.live), self.names_blocks,
        )  # fmt: skip


def _same_bits(recorded: Any, computed: Any) -> Any:
    """Compared as integers, so that not even the sign of a zero may differ; NaN equals NaN of the same payload."""
    return np.ascontiguousarray(recorded).view(np.int64) == np.ascontiguousarray(computed).view(np.int64)
