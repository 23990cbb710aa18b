"""Adaptation in a daemon: switched on over the API, shown in the status, and a warning where it reaches its bound."""

from __future__ import annotations

import pytest
import yaml
from daemon.test_effects_in_service import PlantRig

from fffo_drive.daemon import settings
from fffo_drive.documents import DocumentError, read_text
from fffo_drive.formats import over
from fffo_drive.workflows.plan import make_plan

KEY = "controller.adaptation.enabled"


class AdaptingRig(PlantRig):
    """Bounds so narrow that the plant's friction, which is not the model's, leads to them in seconds."""

    @staticmethod
    def forgive(axis):
        PlantRig.forgive(axis)
        axis["controller"].setdefault("observer", {}).update(learns_in="integral", toggle="ff")
        axis["controller"]["feedforward"] = {"inertia": True, "preview": True, "delay_aware": True}
        axis["controller"]["adaptation"] = {"time_s": 5, "bound_share": 0.001}


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.timeout(300)
def test_it_is_switched_on_live_shown_and_warns_at_its_bound(tmp_path):
    with AdaptingRig(tmp_path) as rig:
        client = rig.client()
        status = rig.until("ready", client)
        assert "adaptation" not in status["loop"]
        client.call("set", key=KEY, value=True)
        client.call("enable")
        status = rig.run_until(client, lambda s: s["loop"]["adaptation"]["at_bound"])
        learned = status["loop"]["adaptation"]
        assert any(learned[name] != 0.0 for name in ("offset_nm", "coulomb_nm", "viscous_nm_per_rps"))
        rig.run_until(client, lambda _: rig.events("adaptation"))
        event = rig.events("adaptation")[0]
        assert event["level"] == "warning"
        assert "has reached its bound" in event["text"]


def test_it_is_refused_where_the_p_and_i_terms_are_not_what_the_model_lacks(tmp_path):
    from bad_input.cases import AXIS, DRIVE, FILES, MODEL

    for name in (AXIS, DRIVE, MODEL):
        (tmp_path / name).write_text(read_text(FILES / name))
    plan = make_plan(tmp_path / AXIS)
    assert settings.with_value(plan, plan.toggle, KEY, True).axis.controller.adaptation.enabled
    axis = yaml.safe_load(read_text(tmp_path / AXIS))
    for changes, said in (
        ({"observer": {"learns_in": "friction"}}, r"learns_in must be 'integral'"),
        ({"feedforward": {"preview": False}}, r"needs feedforward\.preview: without them"),
    ):
        (tmp_path / AXIS).write_text(yaml.safe_dump({**axis, "controller": over(axis["controller"], changes)}))
        plan = make_plan(tmp_path / AXIS)
        with pytest.raises(DocumentError, match=said):
            settings.with_value(plan, plan.toggle, KEY, True)
