"""A model file of a linear axis has a mass in kg, and comes back as it was; files of rotary axes are as they were."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from fffo_drive.documents import DocumentError
from fffo_drive.model.parameters import Quantity, content_hash, effect_model, model_text, read_model

TABLE1 = Path(__file__).resolve().parents[2] / "configs" / "models" / "table1.yaml"


def linear(mass_kg, sd):
    model = read_model(TABLE1)
    inertia = Quantity(value=mass_kg / 6.283185307179586, sd=sd / 6.283185307179586)
    return model.model_copy(update={"units": "linear", "inertia_kg_m2": inertia})


@given(st.floats(1e-3, 1e4), st.floats(1e-6, 1e2))
def test_a_mass_comes_back_with_its_hash(tmp_path_factory, mass_kg, sd):
    path = tmp_path_factory.mktemp("model") / "model.yaml"
    path.write_text(model_text(linear(mass_kg, sd)))
    said = yaml.safe_load(path.read_text())
    assert "inertia_kg_m2" not in said
    assert said["mass_kg"]["value"] == pytest.approx(mass_kg, rel=1e-14)
    assert said["mass_kg"]["sd"] == pytest.approx(sd, rel=1e-14)
    back = read_model(path)  # the hash is that of the content
    assert model_text(back) == path.read_text()
    # force = mass * m/s2
    assert back.axis_config().inertia_nm_s2_per_rev == pytest.approx(mass_kg, rel=1e-13)


def test_a_rotary_model_is_written_as_before():
    model = read_model(TABLE1)
    assert "units" not in yaml.safe_load(model_text(model))
    assert content_hash(model) == content_hash(model.model_copy(update={"units": "rotary"}))


def test_a_mass_on_a_rotary_axis_is_refused_by_its_key(tmp_path):
    said = yaml.safe_load(model_text(linear(95.0, 0.2)))
    del said["content_hash"]
    said["units"] = "rotary"
    path = tmp_path / "model.yaml"
    path.write_text(yaml.safe_dump(said))
    with pytest.raises(DocumentError, match="mass_kg"):
        read_model(path)
    said["units"] = "linear"
    said["mass_kg"]["value"] = "heavy"
    path.write_text(yaml.safe_dump(said))
    with pytest.raises(DocumentError, match=r"model\.yaml"):
        read_model(path)


def test_the_file_of_a_linear_axis_says_what_its_keys_are_and_keeps_them(tmp_path):
    """Older readers know the keys; people read the comment. It is none of the content."""
    effects = [
        effect_model("asymmetric_viscous", {"excess_nm_per_rps": -39.0}, {}),
        effect_model("cogging", {"cos_nm": 1.0, "sin_nm": 0.5, "order": 400.0}, {}),
    ]
    model = linear(95.0, 0.2).model_copy(update={"effects": effects})
    text = model_text(model)
    said = [line for line in text.splitlines() if line.startswith("#")]
    assert [line for line in said if "torque_constant_nm_per_a: the force constant, in N" in line]
    assert "#   viscous_nm_per_rps: viscous_n_s_per_m, in N s/m" in said
    assert "#   asymmetric_viscous: excess_nm_per_rps: excess_n_s_per_m, in N s/m" in said
    assert "#   cogging: order: in 1/m" in said
    assert yaml.safe_load(text)["effects"][0]["parameters"]["excess_nm_per_rps"]["value"] == -39.0
    path = tmp_path / "model.yaml"
    path.write_text(text)
    assert model_text(read_model(path)) == text
    assert content_hash(read_model(path)) == content_hash(model)
    assert not model_text(model.model_copy(update={"units": "rotary"})).startswith("#")
