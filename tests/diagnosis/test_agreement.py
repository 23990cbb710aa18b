"""What `identify` writes into a model, `diagnose` of the same runs finds as well."""

import pytest
from shared_data import shared_files

from fffo_drive.identification.dataset import load_records
from fffo_drive.identification.facts import read_facts
from fffo_drive.identification.fit import FitSettings
from fffo_drive.workflows.diagnose import diagnose
from fffo_drive.workflows.identify import fitted_model

FILES = ("drive.yaml", "identify.csv.gz", "track.csv.gz", "recipe.csv.gz")


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("drive", ["d02", "d03"])
def test_both_find_the_same_effects_and_the_same_axis(drive):
    """d02: friction that differs by direction, beside cogging, which a constant torque resembles. d03: an error of the
    sensor, whose second order looks like a wave of the torque.
    """
    facts_file, *logs = (shared_files(f"blind/{drive}/{name}")[0] for name in FILES)
    facts = read_facts(facts_file)
    records = load_records(logs, facts)
    fit, model = fitted_model(records, facts, "identified", FitSettings(compare_literal=False))
    found = diagnose(records, [], facts)
    named = {finding.name for finding in found.findings if finding.accepted}
    assert {effect.name for effect in fit.effects} <= named
    assert found.model_after is not None
    for ours, theirs in (
        (model.inertia_kg_m2, found.model_after.inertia_kg_m2),
        (model.friction.coulomb_nm, found.model_after.friction.coulomb_nm),
    ):
        assert ours.value == pytest.approx(theirs.value, rel=0.03)
