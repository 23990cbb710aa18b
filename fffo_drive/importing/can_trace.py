"""Traces of a CAN bus: what the PDOs of one CiA 402 drive say, a row for each SYNC or each of its positions.

The mapping of the PDOs is that which the trace itself sets by SDO, else that of an EDS or DCF, else that of this
program with the drive's profile or axis file. Nothing is decoded whose frames have another length than its mapping.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats
from ..can.frame import NODE_IDS, RPDO1, RPDO2, STANDARD_MASK, SYNC, TPDO1
from ..drive.canopen.eds import read_eds
from ..drive.canopen.eds_tidy import SIGNED_BITS, decode
from ..drive.canopen.object_map import (
    CONTROLWORD,
    CURRENT,
    MAX_SYNC_TYPE,
    MODE,
    MODE_DISPLAY,
    POSITION,
    STATUSWORD,
    TARGET_TORQUE,
    TORQUE,
    TORQUE_OFFSET,
    VELOCITY,
    MappedObject,
    MappingError,
    PdoMap,
    object_name,
)
from ..drive.canopen.reported_units import MILLI, reported_units, unit_remarks
from ..recording.errors import RecordingError
from .can_frames import Frames, Ints, read_frames
from .can_objects import Place, Stretch, longest_stretch, nodes_of, numbers_of, pdos_of
from .candidates import (
    COMMAND_A,
    CURRENT_A,
    POSITION_REV,
    REFERENCE_RPS,
    SETPOINT_REV,
    TIME_S,
    VELOCITY_RPS,
    AnswerNeededError,
)
from .evidence import at_stamps, says_nothing
from .source import Source, TraceDrive

TARGET_POSITION, TARGET_VELOCITY = 0x607A, 0x60FF
POSITION_DEMAND, VELOCITY_DEMAND, TORQUE_DEMAND = 0x6062, 0x606B, 0x6074
COUNTS, SPEED, TORQUES, CURRENTS = "counts_per_rev", "velocity_units_per_rps", "rated_torque_nm", "rated_current_a"
OBJECTS = {  # of CiA 402: name as there, the key that scales it
    POSITION: ("position actual value", COUNTS),
    VELOCITY: ("velocity actual value", SPEED),
    TORQUE: ("torque actual value", TORQUES),
    CURRENT: ("current actual value", CURRENTS),
    TARGET_TORQUE: ("target torque", TORQUES),
    TORQUE_OFFSET: ("torque offset", TORQUES),
    TORQUE_DEMAND: ("torque demand", TORQUES),
    TARGET_POSITION: ("target position", COUNTS),
    POSITION_DEMAND: ("position demand value", COUNTS),
    TARGET_VELOCITY: ("target velocity", SPEED),
    VELOCITY_DEMAND: ("velocity demand value", SPEED),
}
ROLES = {  # signal -> the objects that may be it, the best first
    POSITION_REV: (POSITION,),
    VELOCITY_RPS: (VELOCITY,),
    COMMAND_A: (TARGET_TORQUE, TORQUE_DEMAND),
    CURRENT_A: (TORQUE, CURRENT),
    REFERENCE_RPS: (VELOCITY_DEMAND, TARGET_VELOCITY),
    SETPOINT_REV: (POSITION_DEMAND, TARGET_POSITION),
}
WORDS = (CONTROLWORD, STATUSWORD, MODE, MODE_DISPLAY)  # no quantities
OPTIONS = {
    COUNTS: "--counts-per-turn",
    SPEED: "--velocity-units",
    TORQUES: "--rated-torque",
    CURRENTS: "--rated-current",
}
SPACING = RPDO2 - RPDO1  # of the PDOs in the predefined connection set (CiA 301, 7.3.3) ...
PREDEFINED = 4  # ... which has so many of each direction
ENABLED_MASK, ENABLED = 0x6F, 0x27  # of the statusword: operation enabled
_NODE_ID = re.compile(r"^\s*NodeID\s*=\s*(0x[0-9a-f]+|\d+)", re.IGNORECASE | re.MULTILINE)
FLOAT32 = 0x08  # data type (CiA 301, 7.4.7)
FITTING = 0.99  # of the frames of a PDO that must have the length of its mapping, or be alone in their SYNC interval
MISSING = (
    "its frames hold the drive's values as bytes, and only the mapping of the PDOs says what they mean: give it with "
    "--eds FILE (the EDS or DCF of the drive, a drive profile, or an axis file)"
)


class NodeNeededError(AnswerNeededError):
    """Several nodes are in a trace, and nobody said which: `TraceDrive.node` does."""


class DriveScale(NamedTuple):
    """A key of the drive section, where it is from, and whether that is this very drive."""

    value: float
    said: str
    sure: bool


class _Objects:
    """What is known of a node: by the trace, then by the values of a DCF, then by the defaults of an EDS."""

    def __init__(self, trace: Stretch, dictionary: Any, defaults: bool) -> None:
        self._trace, self._dictionary, self._defaults = trace, dictionary, defaults

    def has(self, index: int, sub: int = 0) -> bool:
        """Whether it has a value."""
        return self.value(index, sub) is not None

    def value(self, index: int, sub: int = 0) -> int | None:
        """The value of an object."""
        if (shown := self._trace.value(index, sub)) is not None or self._dictionary is None:
            return shown
        variable = self._dictionary.get_variable(index, sub)
        found = getattr(variable, "value", None)
        if found is None and self._defaults:
            found = getattr(variable, "default", None)
        return found if isinstance(found, int) else None


class _Item(NamedTuple):
    """One mapped object in the frames of its PDO."""

    place: MappedObject
    values: Floats
    frames: Ints  # the frame whose instant each value has
    of_drive: bool  # TPDO: measured; else held from its frame on


def read_trace(path: Path, kind: str, drive: TraceDrive | None) -> Source:
    """One drive's motion in a trace. Raises RecordingError naming the option that is missing."""
    drive = drive or TraceDrive()
    frames = read_frames(path, kind)
    channel, node = _node(path, kind, frames, drive)
    frames = frames.of(frames.channels == channel)
    trace = longest_stretch(frames, node)
    frames = frames.of(np.arange(trace.first, trace.last))
    dictionary = None
    if drive.eds is not None:
        try:
            dictionary = read_eds(str(drive.eds), node).dictionary
        except MappingError as error:
            raise RecordingError(str(error)) from error
    reader = _Reader(path, kind, drive, frames, trace, node, dictionary)
    return reader.source()


def _node(path: Path, kind: str, frames: Frames, drive: TraceDrive) -> tuple[int, int]:
    """Channel and node id that are asked for, or the only ones there are."""
    there = nodes_of(frames)
    named = len(frames.channel_names) > 1
    told = [f"{frames.channel_names[c]}:{n}" if named else f"{n}" for c, n in there]
    listed = f"the trace has PDOs of {', '.join(told)}" if told else "no node sends PDOs in it"
    if drive.node is not None:
        channel, _, number = drive.node.rpartition(":")
        if not number.isdigit() or int(number) not in NODE_IDS:
            raise RecordingError(f"--node {drive.node}: give a node id of 1 to 127, or CHANNEL:ID; {listed}")
        there = [k for k in there if k[1] == int(number) and channel in ("", frames.channel_names[k[0]])]
        if not there:
            raise RecordingError(f"{path}: --node {drive.node}: {listed}")
    if len(there) > 1 and drive.node is None:
        there = [k for k in there if k[1] == _described_node(drive)] or there
    if not there:
        raise RecordingError(f"{path}: a trace of a CAN bus ({kind}): {listed}")
    if len(there) > 1:
        raise NodeNeededError(
            f"{path}: a trace of a CAN bus ({kind}); {listed}: say which with --node, such as --node {told[0]}",
            "--node ID",
        )
    return there[0]


def _described_node(drive: TraceDrive) -> int | None:
    """The node id in a DCF (CiA 306, DeviceComissioning), or in an axis file."""
    text = decode(drive.eds.read_bytes())[0] if drive.eds is not None and drive.eds.is_file() else ""
    found = _NODE_ID.search(text)
    return drive.node_of_axis if found is None else int(found[1], 0)


class _Reader:
    """The frames of one node, with what is known of it."""

    def __init__(
        self, path: Path, kind: str, drive: TraceDrive, frames: Frames, trace: Stretch, node: int, dictionary: Any
    ) -> None:
        self.path, self.kind, self.drive, self.frames, self.trace = path, kind, drive, frames, trace
        self.node, self.dictionary = node, dictionary
        self.remarks = list(frames.remarks)
        count = frames.ids.size
        # the clock by which values are put side by side: it goes on where stamps begin anew
        clock = np.arange(count, dtype=np.float64) if frames.stamps_s is None else frames.stamps_s
        steps = np.diff(clock, prepend=clock[:1])
        self.clock = np.cumsum(np.maximum(steps, 0.0))
        known = _Objects(trace, dictionary, True)
        sync = (known.value(0x1005) or SYNC) & STANDARD_MASK
        self.syncs = np.flatnonzero(frames.ids == sync)
        self.scales = self._scales()

    def source(self) -> Source:
        """The rows."""
        rpdos, tpdos = self._mapping()
        items = [item for pdo in tpdos for item in self._items(pdo, True)]
        items += [item for pdo in rpdos for item in self._items(pdo, False)]
        motion = [item for item in items if item.place.index in (POSITION, VELOCITY) and item.values.size > 1]
        if not motion:
            raise RecordingError(f"{self.path}: the PDOs of node {self.node} carry neither 0x6064 nor 0x606C")
        rows = max(motion, key=lambda item: item.values.size).frames
        columns: dict[str, Floats] = {}
        units: dict[str, str] = {}
        doubts: dict[str, str] = {}
        names: dict[Place, str] = {}
        for item in self._summed(items):
            index = item.place.index
            if index == STATUSWORD:
                enabled = (item.values.astype(np.int64) & ENABLED_MASK) == ENABLED
                columns["operation enabled"] = self._held(enabled.astype(np.float64), item.frames, rows)
            place = (index, item.place.sub)
            if index in WORDS or place in names:
                continue
            name = self._name_of(item.place)
            factor, unit, doubt = self._factor(item.place)
            on_rows = self._at(item, rows) if item.of_drive else self._held(item.values, item.frames, rows)
            columns[name] = on_rows * factor
            names[place] = name
            units |= {name: unit} if unit else {}
            doubts |= {name: doubt} if doubt else {}
        if names.get((POSITION, 0), "") in columns.keys() - doubts:  # a velocity is held against its derivative
            doubts = {name: text for name, text in doubts.items() if units.get(name) != "rps"}
        return self._trimmed(rows, columns, units, doubts, self._roles(names, columns))

    def _roles(self, names: Mapping[Place, str], columns: Mapping[str, Floats]) -> dict[str, str]:
        """Signal -> column. A torque that nobody commands (the drive is in another mode) is no command."""
        own = {signal: [(index, 0) for index in indices] for signal, indices in ROLES.items()}
        if (config := self.drive.config) is not None:
            own[COMMAND_A].insert(0, (config.target.index, config.target.sub))
            own[CURRENT_A].insert(0, (config.torque.index, config.torque.sub))
        found = {
            signal: [names[place] for place in able if place in names and not says_nothing(columns[names[place]])]
            for signal, able in own.items()
        }
        return {signal: able[0] for signal, able in found.items() if able}

    # --- PDOs

    def _mapping(self) -> tuple[list[PdoMap], list[PdoMap]]:
        """RPDOs and TPDOs of the first description that fits the frames. Raises RecordingError."""
        able: list[tuple[str, list[PdoMap], list[PdoMap]]] = []
        shown = any(0x1A00 <= index < 0x1C00 for index, _ in self.trace.values)
        if self.dictionary is not None or shown:
            said = " and ".join(filter(None, ["the trace" if shown else "", str(self.drive.eds or "")]))
            rpdos, tpdos = pdos_of(_Objects(self.trace, self.dictionary, True).value)
            able.append((said, self._of_this_node(rpdos, RPDO1), self._of_this_node(tpdos, TPDO1)))
        if self.drive.config is not None:
            own = replace(self.drive.config, node_id=self.node, master_id=127 if self.node != 127 else 126)
            able.append((self.drive.said or "the profile", [own.command], list(own.answers)))
        if not able:
            raise AnswerNeededError(
                f"{self.path}: a trace of a CAN bus ({self.kind}), node {self.node}: {MISSING}", "--eds FILE"
            )
        problems = []
        for said, rpdos, tpdos in able:
            wrong = [*self._misfits(tpdos, "TPDO"), *self._misfits(rpdos, "RPDO")]
            if not wrong and not any(self._has_motion(pdo) for pdo in tpdos):
                maps = "; ".join(f"TPDO{p.number} {', '.join(map(str, p.objects))}" for p in tpdos) or "no TPDO"
                wrong = [f"no TPDO in the trace carries 0x6064 or 0x606C ({maps})"]
            if not wrong:
                there = [p for p in (*tpdos, *rpdos) if (self.frames.ids == p.cob_id).any()]
                told = [f"0x{p.cob_id:X} is {', '.join(map(str, p.objects))}" for p in there]
                self.remarks.append(f"node {self.node}, mapped as {said} has it: {'; '.join(told)}")
                self._tell_others([*tpdos, *rpdos])
                return rpdos, tpdos
            problems.append(f"by {said}: {'; '.join(wrong)}")
        raise RecordingError(
            f"{self.path}: the frames of node {self.node} are not mapped as described; {'. '.join(problems)}. Give the "
            "DCF or the axis file by which the drive was set, or a trace that begins before it is set by SDO"
        )

    def _of_this_node(self, pdos: list[PdoMap], first: int) -> list[PdoMap]:
        """PDOs under the identifiers that the trace has: a file may be of another node (0x1A0 where it is 0x185)."""
        found = []
        for pdo in pdos:
            usual = first + SPACING * (pdo.number - 1) + self.node
            told = (self.frames.ids == pdo.cob_id).any() or pdo.number > PREDEFINED
            found.append(pdo if told or not (self.frames.ids == usual).any() else pdo._replace(cob_id=usual))
        return found

    def _misfits(self, pdos: list[PdoMap], kind: str) -> Iterator[str]:
        for pdo in pdos:
            lengths = self.frames.lengths[self.frames.ids == pdo.cob_id]
            fits = lengths == pdo.data_bytes if kind == "TPDO" else lengths >= pdo.data_bytes
            if lengths.size and np.mean(fits) < FITTING:
                objects = ", ".join(map(str, pdo.objects))
                yield (
                    f"{kind}{pdo.number} (0x{pdo.cob_id:X}) would have {pdo.data_bytes} bytes ({objects}), its frames "
                    f"have {int(np.median(lengths))}"
                )

    def _has_motion(self, pdo: PdoMap) -> bool:
        carried = any(pdo.offset_of(index) >= 0 for index in (POSITION, VELOCITY))
        return carried and bool((self.frames.ids == pdo.cob_id).sum() > 1)

    def _tell_others(self, pdos: list[PdoMap]) -> None:
        known = {pdo.cob_id for pdo in pdos}
        ids = self.frames.ids
        own = (ids & 0x7F == self.node) & (ids > TPDO1) & (ids < 0x580)
        for other in sorted(set(np.unique(ids[own]).tolist()) - known):
            self.remarks.append(f"left out: {int((ids == other).sum())} frames of 0x{other:X}, which nothing maps")

    def _items(self, pdo: PdoMap, of_drive: bool) -> Iterator[_Item]:
        rows = np.flatnonzero((self.frames.ids == pdo.cob_id) & (self.frames.lengths >= pdo.data_bytes))
        if not rows.size:
            return
        instants, rows = self._instants(pdo, rows)
        for k, place in enumerate(pdo.objects):
            kind = self._type_of(place)
            if place.bits > 64 or place.index < 0x1000:  # a gap
                continue
            raw = numbers_of(self.frames, rows, pdo, k, kind != FLOAT32 and kind is not False)
            if kind == FLOAT32 and place.bits == 32:
                values = raw.astype(np.uint32).view(np.float32).astype(np.float64)
            elif OBJECTS.get(place.index, ("", ""))[1] == COUNTS and raw.size:  # a counter: its wraps undone
                values = (raw[0] + np.cumsum(_wound(np.diff(raw, prepend=raw[:1]), place.bits))).astype(np.float64)
            else:
                values = raw.astype(np.float64)
            yield _Item(place, values, instants, of_drive)

    def _type_of(self, place: MappedObject) -> int | bool:
        """Whether an object is signed; FLOAT32."""
        if place.index in OBJECTS:
            return True
        if place.index in (CONTROLWORD, STATUSWORD):
            return False
        config = self.drive.config
        if config is not None and place in (config.target, config.torque):
            return True
        variable = None if self.dictionary is None else self.dictionary.get_variable(place.index, place.sub)
        kind = getattr(variable, "data_type", None)
        return FLOAT32 if kind == FLOAT32 else kind in SIGNED_BITS

    def _instants(self, pdo: PdoMap, rows: Ints) -> tuple[Ints, Ints]:
        """The frame at whose instant the values of a PDO were taken or act, and the rows of these values.

        A synchronous PDO belongs to the SYNC before it: a TPDO was sampled there; an RPDO acts at the next, as the
        command in a row of ours does. Of two in one interval the last counts.
        """
        if not self.syncs.size:
            return rows, rows
        at = np.searchsorted(self.syncs, rows, side="right") - 1
        alone = np.mean(np.diff(at) > 0) if at.size > 1 else 0.0
        every = np.mean(np.diff(at) == 1) if at.size > 1 else 0.0
        if alone < FITTING or (not 0 <= pdo.transmission <= MAX_SYNC_TYPE and every < FITTING):
            return rows, rows
        kept = (at >= 0) & np.append(np.diff(at) > 0, True)
        return self.syncs[at[kept]], rows[kept]

    # --- rows

    def _at(self, item: _Item, rows: Ints) -> Floats:
        if np.array_equal(item.frames, rows):
            return item.values
        share = item.values.size / rows.size
        if share < FITTING:
            self.remarks.append(
                f"{self._name_of(item.place)!r} comes {1.0 / share:.3g} times less often than a row: it is interpolated"
            )
        return at_stamps(item.values, self.clock[item.frames], self.clock[rows])

    def _held(self, values: Floats, frames: Ints, rows: Ints) -> Floats:
        """The last value at each row; NaN before the first."""
        last = np.searchsorted(self.clock[frames], self.clock[rows], side="right") - 1
        return np.where(last >= 0, values[np.maximum(last, 0)], np.nan)

    def _summed(self, items: list[_Item]) -> list[_Item]:
        """Target torque with the torque offset, which the drive adds to it (CiA 402, 0x60B2)."""
        target = next((item for item in items if item.place.index == TARGET_TORQUE), None)
        offset = next((item for item in items if item.place.index == TORQUE_OFFSET), None)
        if target is None or offset is None:
            return items
        added = self._held(offset.values, offset.frames, target.frames)
        whole = target._replace(values=target.values + np.nan_to_num(added))
        if offset.values.any():
            self.remarks.append("the command is the target torque with the torque offset (0x60B2)")
        return [whole if item is target else item for item in items if item is not offset]

    def _trimmed(
        self,
        rows: Ints,
        columns: dict[str, Floats],
        units: dict[str, str],
        doubts: dict[str, str],
        roles: dict[str, str],
    ) -> Source:
        """The rows in which everything is known that a recording has."""
        whole = np.logical_and.reduce([np.isfinite(columns[name]) for name in roles.values()])
        inside = np.flatnonzero(whole)
        if inside.size < 2:
            raise RecordingError(f"{self.path}: node {self.node} is never commanded and heard at the same time")
        part = slice(int(inside[0]), int(inside[-1]) + 1)
        if inside[-1] - inside[0] + 1 < rows.size:
            outside = rows.size - (inside[-1] - inside[0] + 1)
            self.remarks.append(f"{outside} rows before the first or after the last of its values are left out")
        if self.frames.stamps_s is not None:
            columns = {"time_s": self.frames.stamps_s[rows], **columns}
            units["time_s"], roles[TIME_S] = "s", "time_s"
        columns = {name: np.ascontiguousarray(values[part]) for name, values in columns.items()}
        return Source(
            self.path, columns, units, None, {}, tuple(dict.fromkeys(self.remarks)), roles=roles, doubts=doubts
        )

    # --- scales

    def _name_of(self, place: MappedObject) -> str:
        if place.index in OBJECTS:
            return f"{OBJECTS[place.index][0]} 0x{place.index:04X}"
        variable = None if self.dictionary is None else self.dictionary.get_variable(place.index, place.sub)
        return f"{getattr(variable, 'name', None) or 'object'} {object_name(place.index, place.sub)}"

    def _factor(self, place: MappedObject) -> tuple[float, str, str]:
        """(factor, unit after it, doubt) of an object; a unit of "" is left to the recogniser."""
        config, constant = self.drive.config, self.drive.torque_constant_nm_per_a
        sign = -1.0 if config is not None and config.inverted else 1.0
        if config is not None:
            for item, per_a in ((config.target, config.target_units_per_a), (config.torque, config.torque_units_per_a)):
                if (place.index, place.sub) == (item.index, item.sub) and per_a is not None:
                    return sign / per_a, "A", ""
        if place.index not in OBJECTS:
            return 1.0, "", ""
        key = OBJECTS[place.index][1]
        scale = self.scales.get(key)
        if scale is None:
            raw = {COUNTS: "counts", SPEED: ""}.get(key, "permille")
            return sign, raw, ""
        self.remarks.append(f"{key}: {scale.value:g}, {scale.said}")
        doubt = "" if scale.sure else f"{scale.value:g} is {scale.said}, {OPTIONS[key]} says it"
        if key in (COUNTS, SPEED):
            return sign / scale.value, "rev" if key == COUNTS else "rps", doubt
        factor = sign * MILLI * scale.value
        if key == TORQUES and constant:
            return factor / constant, "A", doubt
        return factor, "Nm" if key == TORQUES else "A", doubt

    def _scales(self) -> dict[str, DriveScale]:
        """Each scale from what is nearest to this very drive."""
        drive, config = self.drive, self.drive.config
        units = (MILLI, MILLI) if config is None else (config.rated_torque_unit_nm, config.rated_current_unit_a)
        file = str(drive.eds or "")

        def by(dictionary: Any, defaults: bool) -> dict[str, Any]:
            return reported_units(_Objects(self.trace, dictionary, defaults), *units)

        layers: list[tuple[Mapping[str, Any], str, bool]] = [
            (drive.keys, "as given", True),
            (by(None, False), "by SDO in the trace", True),
            (by(self.dictionary, False), f"the value in {file}", True),
            (drive.profile_keys if drive.profile_named else {}, f"by {drive.said}", True),
            (by(self.dictionary, True), f"a default of {file}", False),
            (drive.profile_keys, f"the factory setting by {drive.said}", False),
        ]
        found: dict[str, DriveScale] = {}
        for key in OPTIONS:
            for values, said, sure in layers:
                if values.get(key) is not None:
                    found[key] = DriveScale(float(values[key]), said, sure)
                    break
        self.remarks += unit_remarks(_Objects(self.trace, self.dictionary, True))
        return found


def _wound(steps: Any, bits: int) -> Any:
    """Steps of a counter of so many bits, each the shorter way round."""
    half = 1 << bits - 1
    return (steps + half & (1 << bits) - 1) - half if bits < 64 else steps
