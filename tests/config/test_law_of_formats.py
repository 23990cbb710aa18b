"""The law of an axis file by the number of its format: today's default is the best one, an older file keeps its own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from fffo_drive import formats
from fffo_drive.config.axis import AxisFile, controller_config, model_of, read_axis
from fffo_drive.config.scenario import axis_of, candidates_of, read_scenario
from fffo_drive.config.sections import ControllerSection, best_law
from fffo_drive.control.controller import AS_IN_MOTION, ControllerConfig
from fffo_drive.control.feedforward import NO_FEEDFORWARD
from fffo_drive.control.velocity_estimator import DRIVE_VELOCITY
from fffo_drive.documents import DocumentError, check

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
AXIS = CONFIGS / "axis_simulated.yaml"
GAINS = {"proportional_a_per_rps": 0.975, "integral_a_per_rev": 9.75, "current_limit_a": 12.0}
BOTH = {True: "fffo_drive/axis/2", False: "fffo_drive/axis/1"}

parts = st.fixed_dictionaries(
    {},
    optional={
        "error_filter_s": st.sampled_from([0.0, 0.0002, 0.001]),
        "observer": st.fixed_dictionaries(
            {},
            optional={
                "toggle": st.sampled_from(["ff", "fb", "off"]),
                "learns_in": st.sampled_from(["friction", "integral"]),
            },
        ),
        "at_rest": st.fixed_dictionaries(
            {},
            optional={
                "gain_share": st.sampled_from([0.2, 0.5, 1.0]),
                "release_friction": st.booleans(),
                "time_s": st.sampled_from([0.05, 0.1]),
            },
        ),
        "feedforward": st.fixed_dictionaries(
            {}, optional={name: st.booleans() for name in ("inertia", "preview", "delay_aware")}
        ),
    },
)


def document(controller: dict[str, Any], said: str | None) -> dict[str, Any]:
    """A parsed axis file with this law; `said`: its format."""
    data = yaml.safe_load(AXIS.read_text())
    data["controller"] = {**GAINS, **controller}
    return {key: value for key, value in {**data, "format": said}.items() if value is not None}


def section(controller: dict[str, Any], said: str | None) -> ControllerSection:
    return check(document(controller, said), AxisFile, "axis.yaml").controller


def is_papers(law: ControllerConfig) -> bool:
    """Whether it is PI with friction observer and nothing beyond it."""
    nothing = law.feedforward == NO_FEEDFORWARD and law.error_share == 1.0 and law.velocity == DRIVE_VELOCITY
    return nothing and law.rest._replace(fade_share=1.0) == AS_IN_MOTION and not law.observer.learns_in_integral


def law_of(controller: dict[str, Any], said: str | None) -> ControllerConfig:
    axis = check(document(controller, said), AxisFile, "axis.yaml")
    return controller_config(axis, model_of(AXIS, axis))


@pytest.mark.parametrize("said", [None, "fffo_drive/axis/1"])
def test_a_file_of_1_that_says_nothing_has_the_papers_law(said):
    assert is_papers(law_of({}, said))


def test_a_file_of_today_that_says_nothing_has_every_part_of_the_law():
    law = law_of({}, "fffo_drive/axis/2")
    feedforward = law.feedforward
    assert feedforward.inertia_nm_s2_per_rev > 0.0
    assert feedforward.ahead_ticks > feedforward.behind_ticks > 0.0
    assert law.observer.learns_in_integral
    assert law.rest.release_share > 0.0
    assert not is_papers(law)


def test_the_parts_of_the_best_law_are_those_that_the_papers_has_not():
    def leaves(law: dict[str, Any], at: str = "") -> dict[str, Any]:
        found: dict[str, Any] = {}
        for key, value in law.items():
            found |= leaves(value, f"{at}{key}.") if isinstance(value, dict) else {f"{at}{key}": value}
        return found

    best, papers = leaves(best_law()), leaves(formats.PAPER_LAW)
    assert best.keys() == papers.keys()
    assert [key for key in best if best[key] == papers[key]] == []


@given(parts, st.booleans())
def test_what_a_file_says_it_means_in_every_format(controller, newer):
    found = section(controller, BOTH[newer]).model_dump()
    for key, value in controller.items():
        said = value if isinstance(value, dict) else {None: value}
        for inner, one in said.items():
            assert (found[key] if inner is None else found[key][inner]) == one


@given(parts)
def test_a_file_of_1_means_what_it_means_with_its_silent_parts_switched_off(controller):
    spelled = formats.over(formats.PAPER_LAW, controller)
    assert section(controller, BOTH[False]) == section(spelled, BOTH[True])


@given(parts)
def test_the_papers_law_is_that_of_a_file_of_1_with_these_gains(controller):
    one = section(controller, BOTH[True])
    plain = {"observer": {"toggle": one.observer.toggle}, "at_rest": {"time_s": one.at_rest.time_s}}
    assert one.papers == section(plain, BOTH[False])


@pytest.mark.parametrize("controller", [None, 3, [], {"observer": 3}, {"feedforward": None}, {"at_rest": "soft"}])
def test_a_law_that_is_no_mapping_is_refused_at_its_key_in_an_old_file_too(controller):
    data = document({}, BOTH[False])
    data["controller"] = {**GAINS, **controller} if isinstance(controller, dict) else controller
    with pytest.raises(DocumentError, match=r"controller\.?\w*: a mapping of keys to values is needed"):
        check(data, AxisFile, "axis.yaml")
    del data["controller"]
    with pytest.raises(DocumentError, match=r"^axis\.yaml:1: controller: missing$"):
        check(data, AxisFile, "axis.yaml", {(): 1})


@pytest.mark.parametrize("path", sorted((CONFIGS / "scenarios").glob("*.yaml")), ids=lambda p: p.stem)
def test_the_papers_controllers_are_the_papers_by_name_and_the_best_is_that_of_the_axis_file(path):
    scenario = read_scenario(path)
    by_name = {candidate.name: candidate.controller for candidate in candidates_of(scenario, 1)}
    for name in ("pi", "pi+fbfo", "pi+fffo"):
        assert is_papers(by_name[name])
    assert axis_of(scenario, "pi+fffo+").controller == read_axis(scenario.axis_path).controller
    assert not is_papers(by_name["pi+fffo+"])


SCENARIO = f"""\
name: short
axis: {AXIS}
reference: {{kind: sine, duration_s: 1, amplitude: 2, frequency_hz: 2}}
controllers:
"""


def laws_in(tmp_path: Path, text: str) -> dict[str, ControllerSection]:
    path = tmp_path / "scenario.yaml"
    path.write_text(text)
    scenario = read_scenario(path)
    return {name: axis_of(scenario, name).controller for name in scenario.file.controllers}


def test_a_scenario_of_1_keeps_its_controllers(tmp_path):
    controllers = "  a: {toggle: ff}\n  b: {toggle: ff, feedforward: {inertia: true}, at_rest: {time_s: 0.2}}\n"
    found = laws_in(tmp_path, "format: fffo_drive/scenario/1\n" + SCENARIO + controllers)
    assert not any(found["a"].feedforward.model_dump().values())
    assert found["b"].feedforward.model_dump() == {"inertia": True, "preview": False, "delay_aware": False}
    assert (found["b"].at_rest.gain_share, found["b"].at_rest.release_friction) == (1.0, False)


def test_a_controller_of_today_is_the_axis_files_or_the_papers_with_what_it_says(tmp_path):
    controllers = "  a: {toggle: ff}\n  b: {law: paper, toggle: ff, error_filter_s: 0.001}\n"
    found = laws_in(tmp_path, "format: fffo_drive/scenario/2\n" + SCENARIO + controllers)
    own = read_axis(AXIS).controller
    assert found["a"] == own
    assert found["b"] == own.papers.changed({"error_filter_s": 0.001})


def test_a_controller_that_adapts_beside_the_papers_observer_is_refused_at_its_key(tmp_path):
    controllers = "  a: {toggle: ff, adaptation: {enabled: true}}\n"
    with_law = controllers.replace("toggle", "law: paper, toggle")
    assert laws_in(tmp_path, "format: fffo_drive/scenario/2\n" + SCENARIO + controllers)["a"].adaptation.enabled
    with pytest.raises(DocumentError, match=r"scenario\.yaml:6: controllers\.a\.adaptation\.enabled: .*'integral'"):
        laws_in(tmp_path, "format: fffo_drive/scenario/2\n" + SCENARIO + with_law)
