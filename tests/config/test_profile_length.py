"""How long a profile lasts is arithmetic: it is known before a sample is made, and a day of samples is never made."""

from __future__ import annotations

import tracemalloc

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from fffo_drive.cli import main
from fffo_drive.config.axis import build_profile
from fffo_drive.config.profile_sections import ProfileSection, duration_s
from fffo_drive.config.sections import LoopSection, length_problems
from fffo_drive.daemon.profiles import chosen_profile
from fffo_drive.documents import DocumentError
from fffo_drive.model.effects.registry import LAWS
from fffo_drive.workflows.plan import make_plan

SECTIONS = TypeAdapter(ProfileSection)
PERIOD_S = 0.001
SHORT = st.floats(1.5, 4.0)
PARTS = st.fixed_dictionaries({"high_rps": st.floats(5.0, 30.0), "acceleration_rps2": st.floats(50.0, 500.0)})
KINDS = st.one_of(
    st.fixed_dictionaries({"kind": st.sampled_from(["paper", "identify", "frf"]), "duration_s": SHORT}),
    st.fixed_dictionaries(
        {"kind": st.just("sine"), "duration_s": SHORT, "amplitude": st.just(1), "frequency_hz": st.just(2)}
    ),
    st.lists(SHORT, min_size=1, max_size=5, unique=True).map(
        lambda times: {"kind": "points", "points": [[0, 0], *([time, 1.0] for time in sorted(times))]}
    ),
    PARTS.map(lambda shape: {"kind": "recipe", "repeats": 1, **shape}),
    st.tuples(PARTS, st.sampled_from(sorted(LAWS))).map(lambda p: {"kind": "decide", "effect": p[1], **p[0]}),
)


@given(KINDS)
def test_the_arithmetic_is_what_the_samples_come_to(content):
    section = SECTIONS.validate_python(content)
    pieces = 40  # each part, and each half of a part, is rounded to a period by itself
    assert build_profile(section, PERIOD_S).duration_s == pytest.approx(duration_s(section), abs=pieces * PERIOD_S)


ENDLESS = [
    {"kind": "sine", "duration_s": 86_400, "amplitude": 1, "frequency_hz": 1},
    {"kind": "points", "points": [[0, 0], [86_400, 0]]},
    {"kind": "paper", "duration_s": 86_400},
    {"kind": "identify", "duration_s": 86_400},
    {"kind": "frf", "duration_s": 86_400},
    {"kind": "recipe", "acceleration_rps2": 1e-9},
    {"kind": "decide", "effect": "cogging", "high_rps": 1e-9},
    {"kind": "decide", "effect": "cogging", "acceleration_rps2": 1e-300},
]


@pytest.fixture
def plan(axis_directory):
    return make_plan(axis_directory / "axis.yaml")


@pytest.fixture
def axis_directory(tmp_path):
    from bad_input.cases import AXIS, DRIVE, FILES, MODEL

    for name in (AXIS, DRIVE, MODEL):
        (tmp_path / name).write_text((FILES / name).read_text())
    return tmp_path


@pytest.mark.parametrize("content", ENDLESS, ids=lambda content: content["kind"])
def test_a_profile_without_end_is_refused_before_a_sample_is_made(plan, content):
    section = SECTIONS.validate_python(content)
    length_problems(section, LoopSection())  # what is imported for it is imported
    tracemalloc.start()
    try:
        with pytest.raises(DocumentError, match=r"profile: lasts .* s, loop\.longest_profile_s is 600"):
            chosen_profile(plan, section)
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    "content",
    [
        {"kind": "points", "points": [[0, 0], [1e-6, 0]]},
        {"kind": "sine", "duration_s": 1e-9, "amplitude": 1, "frequency_hz": 1},
        {"kind": "paper", "duration_s": 0.0005},
    ],
    ids=lambda content: content["kind"],
)
def test_a_profile_of_no_duration_is_refused_in_our_words(plan, content):
    with pytest.raises(DocumentError, match=r"at least 2 periods of the loop, 0\.001 s, are needed"):
        chosen_profile(plan, SECTIONS.validate_python(content))


@pytest.mark.parametrize(
    "content",
    [
        {"kind": "points", "points": [[0, 0], [1e6, 0]]},
        {"kind": "points", "points": [[0, 0], [1, 1e308]]},
        {"kind": "points", "points": [[0, True], [1, 0]]},
        {"kind": "identify", "lowest_hz": 10, "highest_hz": 10},
        {"kind": "frf", "lowest_hz": 50, "highest_hz": 10},
    ],
)
def test_a_section_that_makes_no_samples_is_no_section(content):
    with pytest.raises(ValidationError):
        SECTIONS.validate_python(content)


@pytest.mark.parametrize("kind", ["own", "named", "decide"])
def test_the_file_and_its_named_profiles_are_looked_at_with_their_lines(axis_directory, capsys, kind):
    path = axis_directory / "axis.yaml"
    text, endless = path.read_text(), "{kind: sine, duration_s: 86400, amplitude: 1, frequency_hz: 1}"
    line = 1 + text[: text.index("profile:")].count("\n")
    words, key = ["config", "check", str(path)], "profile"
    if kind == "own":
        text = text.replace("{kind: paper, duration_s: 60}", endless)
    elif kind == "named":
        text += f"daemon: {{profiles: {{night: {endless}}}}}\n"
        line, key = text.count("\n"), "daemon.profiles.night"
    else:
        text = text.replace("duration_s: 60", "duration_s: 5") + "loop: {longest_profile_s: 10}\n"
        words, key = ["run", str(path), "--decide", "stribeck_shape"], "profile"
    path.write_text(text)
    assert main(words) == 78
    assert f"{path}:{line}: {key}: lasts " in capsys.readouterr().err
