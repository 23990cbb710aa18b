"""What YAML may be here: numbers as they look, no aliases, bounded; each refusal with its line and in our words."""

from __future__ import annotations

import json
import tracemalloc
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field

from fffo_drive.cli import main
from fffo_drive.documents import (
    DEEPEST,
    LARGEST_BYTES,
    MOST_ENTRIES,
    DocumentError,
    StrictRecord,
    as_json,
    check,
    load_json,
    parse,
    read_text,
)

LIBRARIES = ("Input should", "RecursionError", "Traceback", "set_int_max_str_digits", "pydantic", "yaml.")


def refusal(text: str) -> str:
    with pytest.raises(DocumentError) as caught:
        parse(text, "x.yaml")
    return str(caught.value)


def test_scalars_are_those_of_yaml_1_2():
    data, _ = parse(
        "a: 010\nb: 1:30\nc: 2026-11-22\nd: 0x1F\ne: 1_000\nf: yes\ng: null\nh: ~\ni:\nj: '1'\n<<: 2\nk: 1e3\nl: +5\n",
        "x",
    )
    assert data == {
        "a": 10, "b": "1:30", "c": "2026-11-22", "d": 31, "e": 1000, "f": "yes", "g": None, "h": None, "i": None,
        "j": "1", "<<": 2, "k": 1000.0, "l": 5,
    }  # fmt: skip
    assert isinstance(data["a"], int)


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        ("a: 1\nb: &it [1]\nc: *it\n", 2, "the anchor &it is not allowed"),
        ("a: 1\nb:\n  - *it\n", 3, "the alias *it is not allowed: write the value itself"),
        ("a: &a [*a]\n", 1, "the anchor &a is not allowed"),
        ("a: 1\n? &k b\n: 2\n", 2, "the anchor &k is not allowed"),
        ("a: !!binary aGk=\n", 1, "the tag tag:yaml.org,2002:binary is not allowed"),
        ("\n\na: !!python/object/apply:os.system [true]\n", 3, "is not allowed: leave it out"),
        ("a: 1\nb: " + "[" * (DEEPEST + 1), 2, f"not allowed deeper than {DEEPEST}"),
        ("a: " + "{b: " * 5000, 1, f"not allowed deeper than {DEEPEST}"),
        ("a: [" + "1," * MOST_ENTRIES + "]", 1, f"more than {MOST_ENTRIES} values"),
        ("a: 1\nb: " + "9" * 5000, 2, "a number of 5000 digits is not allowed"),
        ("a: 0x" + "f" * 5000, 1, "digits is not allowed"),
        ("a: 1\nb: \x07\n", 2, "the character '\\x07'"),
    ],
)
def test_what_no_file_needs_is_refused_with_its_line(text, line, said):
    message = refusal(text)
    assert message.startswith(f"x.yaml:{line}: ")
    assert said in message


def test_ten_aliases_in_each_other_cost_nothing():
    """280 bytes that were 1,234,567 entries, and ten times as many for each 50 bytes more."""
    lines = ["a0: &a0 [1,1,1,1,1,1,1,1,1,1]"]
    lines += [f"a{k}: &a{k} [{','.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 9)]
    tracemalloc.start()
    try:
        refusal("\n".join(lines))
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("text", ["a: &a [*a]\n", "[" * 100_000, "a: " + "9" * 5000])
def test_a_command_ends_with_78_and_one_line(tmp_path, capsys, text):
    path = tmp_path / "axis.yaml"
    path.write_text(text)
    assert main(["config", "check", str(path)]) == 78
    said = capsys.readouterr().err
    assert said.startswith(f"fffo-drive config: {path}:1: ")
    assert len(said.splitlines()) == 1


def test_a_file_that_is_far_too_large_is_not_read(tmp_path):
    path = tmp_path / "axis.yaml"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    tracemalloc.start()
    try:
        with pytest.raises(DocumentError, match=f"larger than {LARGEST_BYTES} bytes"):
            read_text(path)
        assert tracemalloc.get_traced_memory()[1] < 2_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("text", ["[" * 200_000, '{"a": ' * 100_000, "9" * 5000, "{", ""])
def test_json_that_no_program_writes_is_refused(tmp_path, text):
    path = tmp_path / "report.json"
    path.write_text(text)
    with pytest.raises(DocumentError, match="not JSON") as caught:
        load_json(path)
    assert not any(word in str(caught.value) for word in LIBRARIES)


class Inner(StrictRecord):
    high: Annotated[float, Field(gt=0, le=5)]


class Sample(StrictRecord):
    number: float = 0.0
    ranged: Annotated[float, Field(ge=0, le=600)] = 0.0
    maybe: Annotated[float | None, Field(gt=0, lt=1)] = None
    whole: Annotated[int, Field(ge=1)] = 1
    switch: bool = False
    text: str = ""
    several: list[Annotated[float, Field(ge=-1, le=1)]] = Field(default_factory=list)
    inner: Inner | None = None


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("number: true", "x:1: number: a number is needed (got true)"),
        ("number: '1'", "x:1: number: a number is needed (got '1')"),
        ("number: null", "x:1: number: a number is needed (got null)"),
        ("number: .inf", "x:1: number: a finite number is needed (got inf)"),
        ("number: .nan", "x:1: number: a finite number is needed (got nan)"),
        ("ranged: '1'", "x:1: ranged: a number from 0 to 600 is needed (got '1')"),
        ("ranged: 601", "x:1: ranged: a number from 0 to 600 is needed (got 601)"),
        ("maybe: 0", "x:1: maybe: a number above 0 and below 1 is needed (got 0)"),
        ("maybe: true", "x:1: maybe: a number above 0 and below 1 is needed (got true)"),
        ("whole: 1.5", "x:1: whole: a whole number from 1 up is needed (got 1.5)"),
        ("whole: true", "x:1: whole: a whole number from 1 up is needed (got true)"),
        ("whole: 1e3", "x:1: whole: a whole number from 1 up is needed: write 1000 (got 1000.0)"),
        ("switch: 1", "x:1: switch: true or false is needed (got 1)"),
        ("switch: yes", "x:1: switch: true or false is needed (got 'yes')"),
        ("text: 5", "x:1: text: text is needed (in quotes, where it looks like something else) (got 5)"),
        ("several: 5", "x:1: several: a list is needed (got 5)"),
        ("several: [0, true]", "x:1: several.1: a number from -1 to 1 is needed (got true)"),
        ("several: [0, 2]", "x:1: several.1: a number from -1 to 1 is needed (got 2)"),
        ("inner: 5", "x:1: inner: a mapping of keys to values is needed (got 5)"),
        ("inner: {high: 9}", "x:1: inner.high: a number above 0 and up to 5 is needed (got 9)"),
        ("inner: {}", "x:1: inner.high: missing"),
        ("inner: {high: 1, hihg: 2}", "x:1: inner.hihg: unknown key; did you mean 'high'?"),
        ("- 1", "x:1: a mapping of keys to values is needed, this is a list"),
    ],
)
def test_a_wrong_value_is_reported_with_what_is_needed_and_its_range(content, said):
    data, lines = parse(content, "x")
    with pytest.raises(DocumentError) as caught:
        check(data, Sample, "x", lines)
    assert str(caught.value) == said


def test_whole_numbers_are_numbers():
    assert check({"number": 3, "ranged": 600}, Sample, "x").number == 3.0


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.just(10**400),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)


@given(st.dictionaries(st.sampled_from([*Sample.model_fields, "other"]), VALUES, max_size=4))
def test_any_content_is_taken_or_refused_in_our_words(content):
    try:
        record = check(content, Sample, "x")
    except DocumentError as error:
        message = str(error)
    else:
        message = ""
    assert not any(word in message for word in LIBRARIES)
    if message:
        return
    for name, value in content.items():
        assert isinstance(value, bool) == isinstance(getattr(record, name), bool)
        assert isinstance(value, str) == isinstance(getattr(record, name), str)


def test_a_value_in_terms_of_json():
    """A report has null for a number that is not finite; an event says which one it was."""
    value = {1: np.array([1.5, np.nan]), "on": np.bool_(True), "count": np.int32(3), "where": (Path("a"), {2})}
    assert as_json(value) == {"1": [1.5, None], "on": True, "count": 3, "where": ["a", [2]]}
    assert as_json(value, not_finite=str)["1"] == [1.5, "nan"]
    assert as_json(np.float64(-np.inf)) is None
    assert json.dumps(as_json([True, None, np.float32(0.5)]), allow_nan=False) == "[true, null, 0.5]"
