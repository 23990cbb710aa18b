"""Logs of robots: vectors with a number a joint, the choice of one, and LeRobot datasets.

A vector is a list column of Parquet, an array of MCAP messages, the fields of a JointState, a matrix of MATLAB, HDF5 or
NumPy. Its columns are `name[k]` (`name_k` of a matrix, from 1) until a joint is chosen, and `name` from then on.
"""

from __future__ import annotations

import itertools
import json
import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import Floats
from ..documents import did_you_mean
from ..recording.errors import RecordingError
from .candidates import POSITION_REV, SETPOINT_REV, AnswerNeededError
from .evidence import bridged, relation
from .motion import LIKE
from .names import POSITION, VELOCITY, meaning_of
from .source import Source
from .units import split_name

ALL = "all"  # in place of a joint
STATE = "observation.state"  # of LeRobot: positions, where the names of its numbers say nothing else
EPISODE = "episode_index"
INFO = Path("meta") / "info.json"
DATA = "data/*/*.parquet"  # chunk-000/episode_000000 (v2), chunk-000/file-000 (v3)
ACTION = "action"  # of LeRobot: what a policy or a person asked for, mostly positions
MOST_SLOPE = 2.0  # of a set point against the position that follows it
MOST_LISTED = 24
MOVES = 0.05  # of the largest range of positions: a joint that stands has less
_INDEXED = re.compile(r"^(?P<name>[^\[\]]*)\[(?P<index>[^\[\]]+)\](?P<rest>[^\[\]]*)$")
_NUMBERED = re.compile(r"^(?P<name>.+)_(?P<index>\d+)(?P<rest>)$")
_OF_JOINT = re.compile(  # shoulder_pan.pos
    r"^(?P<joint>.+)[._](?P<what>pos|position|vel|velocity|torque|effort|current|temp|temperature)$", re.IGNORECASE
)


class JointNeededError(AnswerNeededError):
    """A log has several joints, and nobody said which: `Hints.joint` does. `joint`: one of them."""

    def __init__(self, text: str, joint: str) -> None:
        super().__init__(text, f"--joint {shlex.quote(joint)}")
        self.joint = joint


def with_joints(source: Source, names: Mapping[str, Sequence[str]] | None = None) -> Source:
    """The source with the joints that its vectors have. `names`: of the numbers of a vector, as a file declares them.

    A vector that has as many numbers as that of the positions (or velocities) has one a joint.
    """
    vectors: dict[str, list[str]] = {}
    for column in source.columns:
        if found := _index_of(column):
            vectors.setdefault(found["name"] + found["rest"], []).append(column)
    parts = {name: _parts_of(name, columns, (names or {}).get(name, ())) for name, columns in vectors.items()}
    motion = sorted((name for name in parts if _moves(name, parts[name])), key=lambda name: name != STATE)
    if not motion:
        return source
    joints: dict[str, dict[str, str]] = {joint: {} for joint, _ in parts[motion[0]]}
    order = list(joints)
    for name, part in parts.items():
        own = list(dict.fromkeys(joint for joint, _ in part))
        if len(own) != len(order):
            continue
        known = dict(zip(own, own if set(own) == set(order) else order, strict=True))
        for column, (joint, plain) in zip(vectors[name], part, strict=True):
            joints[known[joint]][column] = plain
    return replace(source, joints=joints) if len(joints) > 1 else source


def _index_of(column: str) -> re.Match[str] | None:
    return _INDEXED.match(column) or _NUMBERED.match(column)


def _parts_of(name: str, columns: Sequence[str], said: Sequence[str]) -> list[tuple[str, str]]:
    """(joint, column without it) of each number of a vector."""
    if len(said) != len(columns):
        return [(found["index"], name) for column in columns if (found := _index_of(column))]
    ended = [match for one in said if (match := _OF_JOINT.match(one))]
    if len(ended) < len(said):
        return [(one, name) for one in said]
    return [(match["joint"], f"{name}.{match['what']}") for match in ended]


def _moves(name: str, part: Sequence[tuple[str, str]]) -> bool:
    return name == STATE or any(_quantity(plain) in (POSITION, VELOCITY) for _, plain in part)


def _quantity(name: str) -> str | None:
    found = meaning_of(*split_name(name))
    return None if found.asked else found.quantity


def chosen(sources: Sequence[Source], wanted: str | None) -> dict[str, list[Source]]:
    """The sources of each joint that is wanted; "" where they have none. Raises JointNeededError, RecordingError.

    Without a wish the only one that moves is taken.
    """
    joints = list(dict.fromkeys(joint for source in sources for joint in source.joints))
    if not joints:
        if wanted is not None:
            raise RecordingError(f"{sources[0].path}: --joint {wanted}: nothing in it has a number for each joint")
        return {"": list(sources)}
    if wanted == ALL:
        names = joints
    elif wanted is None:
        names = _moving(sources, joints)
    elif wanted in joints:
        names = [wanted]
    elif wanted.isdigit() and int(wanted) < len(joints) and not joints[0].isdigit():
        names = [joints[int(wanted)]]
    else:
        raise RecordingError(f"{sources[0].path}: --joint {wanted}: {did_you_mean(wanted, [*joints, ALL])}")
    return {name: [_of_joint(source, name) for source in sources if name in source.joints] for name in names}


def _moving(sources: Sequence[Source], joints: list[str]) -> list[str]:
    ranges = {joint: max(_range_of(source, joint) for source in sources) for joint in joints}
    moving = [joint for joint in joints if ranges[joint] > MOVES * max(ranges.values())]
    if len(moving) == 1:
        return moving
    listed = ", ".join(joint if joint.isdigit() else f"{k} {joint}" for k, joint in enumerate(joints[:MOST_LISTED]))
    more = f" and {len(joints) - MOST_LISTED} more" if len(joints) > MOST_LISTED else ""
    raise JointNeededError(
        f"{sources[0].path}: {len(joints)} joints ({listed}{more}): say which by name or number, or {ALL}",
        moving[0] if moving else joints[0],
    )


def _range_of(source: Source, joint: str) -> float:
    """Of the position of a joint, or what else moves."""
    columns = source.joints.get(joint, {})
    places = [c for c, plain in columns.items() if _quantity(plain) == POSITION] or [
        c for c, plain in columns.items() if plain == STATE or _quantity(plain) == VELOCITY
    ]
    values = [source.columns[column] for column in places[:1]]
    return max((float(np.nanmax(v) - np.nanmin(v)) for v in values if np.isfinite(v).any()), default=0.0)


def _of_joint(source: Source, joint: str) -> Source:
    """A source of one joint: its own numbers, and the columns that belong to none."""
    own = source.joints[joint]
    others = {column for columns in source.joints.values() for column in columns}
    columns = {name: values for name, values in source.columns.items() if name not in others}
    columns |= {plain: source.columns[column] for column, plain in own.items()}
    units = {name: unit for name, unit in source.units.items() if name in columns}
    units |= {plain: unit for plain in own.values() if (unit := split_name(plain)[1])}
    named = {_quantity(plain) for plain in own.values()}
    roles = {POSITION_REV: STATE} if STATE in columns and POSITION not in named else {}
    place = roles.get(POSITION_REV) or next((plain for plain in own.values() if _quantity(plain) == POSITION), None)
    if ACTION in columns and place is not None and _follows(columns[place], columns[ACTION]):
        roles[SETPOINT_REV] = ACTION
    return replace(source, columns=columns, units=units, joints={}, joint=joint, roles={**source.roles, **roles})


def _follows(position: Floats, asked: Floats) -> bool:
    """Whether a position is what was asked for, in its own unit, apart from what it lags."""
    found = relation(bridged(asked) - np.nanmean(asked), bridged(position) - np.nanmean(position))
    return found.correlation > LIKE and 1.0 / MOST_SLOPE < found.slope < MOST_SLOPE


# --- LeRobot


def dataset_files(directory: Path) -> list[Path]:
    """The files of a LeRobot dataset, or the Parquet files of a directory. Raises RecordingError where it has none."""
    found = sorted(directory.glob(DATA)) or sorted(directory.glob("*.parquet")) or sorted(directory.glob("*/*.parquet"))
    if not found:
        raise RecordingError(
            f"{directory}: is a directory, and no LeRobot dataset ({DATA}, {INFO}): name the files of one axis"
        )
    return found


def declared_names(path: Path) -> tuple[dict[str, list[str]], float | None]:
    """(names of the numbers of each vector, period) by the metadata of the dataset that a file is in."""
    info = next((parent / INFO for parent in path.resolve().parents[:3] if (parent / INFO).is_file()), None)
    if info is None:
        return {}, None
    try:
        content = json.loads(info.read_text(encoding="utf-8"))
        features = {str(key): value for key, value in content.get("features", {}).items() if isinstance(value, dict)}
        rate_hz = float(content.get("fps") or 0.0)
    except (ValueError, AttributeError, TypeError) as error:
        raise RecordingError(f"{info}: not readable as the metadata of a LeRobot dataset: {error}") from error
    return {key: _flat(value.get("names")) for key, value in features.items()}, 1.0 / rate_hz if rate_hz > 0.0 else None


def _flat(names: Any) -> list[str]:
    """Names as datasets have them: a list, lists by group ({"motors": [...]}), a list of lists, or none."""
    if isinstance(names, str):
        return [names]
    if isinstance(names, Mapping):
        names = names.values() if any(isinstance(one, list) for one in names.values()) else names
    return [name for one in names for name in _flat(one)] if isinstance(names, Iterable) else []


def episodes_of(source: Source) -> list[Source]:
    """The episodes that one file of a dataset holds, each as a run."""
    numbers = source.columns.get(EPISODE)
    if numbers is None or not np.isfinite(numbers).all():
        return [source]
    cuts = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), source.rows]
    if len(cuts) == 2:
        return [source]
    parts = (slice(first, last) for first, last in itertools.pairwise(cuts))
    return [source.part(part, int(numbers[part.start]) + 1) for part in parts if part.stop - part.start > 1]
