"""Effects of a user's own: registered or brought by an installed package, in a process of their own each."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from fffo_drive.documents import DocumentError
from fffo_drive.model.effects.law import SHAPE, STRENGTH, Parameter
from fffo_drive.model.effects.registry import LAWS, Laws, register_law

ROOT = Path(__file__).resolve().parents[2]
LAW_FILE = """
from fffo_drive.jit import njit
from fffo_drive.model.effects import slots as s
from fffo_drive.model.effects.law import STRENGTH, Law, Parameter, no_shape
from factors import factor


@njit
def cubic_drag(signals, parameters, memory):
    signals[s.LOAD_NM] += factor() * parameters[0] * signals[s.VELOCITY_RPS] ** 3


LAW = Law(
    name="cubic_drag", axis="velocity", kernel=cubic_drag,
    parameters=(Parameter("drag_nm_per_rps3", "Nm s^3/rev^3", STRENGTH, -1e3, 1e3, 1e-5, "drag"),),
    search=no_shape, meaning="drag with the third power of speed", plain_name="cubic drag", cause="a fluid",
    remedy="none", compensable=True, regime="fast", lookalikes=("quadratic_drag",), experiment="speeds",
    motions=("staircase",), picture="velocity",
)
"""
FACTORS = "from fffo_drive.jit import njit\n\n\n@njit\ndef factor():\n    return FACTOR\n"
TORQUE = """
import numpy as np
from fffo_drive.model.axis import AxisConfig
from fffo_drive.model.effects import slots as s
from fffo_drive.model.effects.table import Term, effects_along
from fffo_drive.model.friction import OMEGA_CLIPPED, FrictionConfig
axis = AxisConfig(9.4e-4, 0.148, 0.00275, FrictionConfig(0.025, 0.067, 0.733, 1.07, 0.003, 778.0, 2.33, OMEGA_CLIPPED))
rows = np.zeros((3, s.N_MOTION))
rows[:, s.VELOCITY_RPS] = 0.0, 1.0, 2.0
print(effects_along([Term("cubic_drag", {"drag_nm_per_rps3": 0.01})], rows, axis, 5e-4)[0].tolist())
"""
MODEL = """
from pathlib import Path
from fffo_drive.model.parameters import effect_model, read_model, write_model
model = read_model(CONFIGS / "table1.yaml")
found = effect_model("cubic_drag", {"drag_nm_per_rps3": 0.01}, {})
write_model("model.yaml", model.model_copy(update={"effects": [found]}))
print(read_model("model.yaml").effects[0].brought_by)
"""
CONFIGS = f"from pathlib import Path\nCONFIGS = Path({str(ROOT / 'configs' / 'models')!r})\n"


def said(place, text, *, without_compiling=False):
    """What a Python text in this directory prints, or the last line of its error."""
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join([str(place), str(ROOT)]), PYTHONWARNINGS="ignore")
    environment["NUMBA_DISABLE_JIT"] = "1" if without_compiling else "0"
    done = subprocess.run([sys.executable, "-c", text], cwd=place, env=environment, capture_output=True, text=True)
    return done.stdout.strip() or done.stderr.strip().splitlines()[-1]


@pytest.fixture
def own(tmp_path):
    (tmp_path / "cubic_drag.py").write_text(LAW_FILE)
    (tmp_path / "factors.py").write_text(FACTORS.replace("FACTOR", "1.0"))
    return tmp_path


def installed(place, name="cubic_drag", value="cubic_drag:LAW"):
    """As pip leaves a package with one entry point."""
    directory = place / "own_effects-1.2.dist-info"
    directory.mkdir()
    (directory / "METADATA").write_text("Metadata-Version: 2.1\nName: own-effects\nVersion: 1.2\n")
    (directory / "entry_points.txt").write_text(f"[fffo_drive.effects]\n{name} = {value}\n")


REGISTER = "import fffo_drive as fd, cubic_drag\nfd.register_law(cubic_drag.LAW)\n"


@pytest.mark.parametrize("without_compiling", [False, True])
def test_a_registered_law_is_computed_and_an_edit_beside_it_is_not_taken_from_the_cache(own, without_compiling):
    given = {"without_compiling": without_compiling}
    assert said(own, REGISTER + TORQUE, **given) == "[0.0, 0.01, 0.08]"
    (own / "factors.py").write_text(FACTORS.replace("FACTOR", "2.0"))
    assert said(own, REGISTER + TORQUE, **given) == "[0.0, 0.02, 0.16]"
    (own / "cubic_drag.py").write_text(LAW_FILE.replace("** 3", "** 2"))
    assert said(own, REGISTER + TORQUE, **given) == "[0.0, 0.02, 0.08]"


def test_an_installed_law_is_known_to_every_process(own):
    installed(own)
    assert said(own, TORQUE) == "[0.0, 0.01, 0.08]"
    assert said(own, CONFIGS + MODEL) == "package own-effects 1.2"


def test_a_model_file_says_which_package_or_file_is_missing(own):
    read = "from fffo_drive.model.parameters import read_model\nread_model('model.yaml')"
    assert said(own, REGISTER + CONFIGS + MODEL) == "file cubic_drag.py"
    line = said(own, read)
    assert "effects[0].name: the effect 'cubic_drag' is not known here, its law is in the file cubic_drag.py" in line
    assert "call fd.register_law(LAW)" in line
    installed(own)
    assert said(own, CONFIGS + MODEL) == "package own-effects 1.2"
    (own / "own_effects-1.2.dist-info" / "entry_points.txt").unlink()
    assert "its law is in the package own-effects 1.2: install that" in said(own, read)


def test_a_package_that_fails_is_named_and_takes_no_other_law_with_it(own):
    installed(own, value="cubic_drag:LOW")
    text = "from fffo_drive.model.effects.registry import LAWS, name_error\nprint(len(LAWS), name_error('cubic_drag'))"
    assert said(own, text).startswith(
        f"{len(LAWS)} the effect 'cubic_drag' of the package own-effects 1.2 cannot be used: module 'cubic_drag' has no"
    )


def test_a_kernel_that_allocates_is_an_error_that_names_its_law(own):
    (own / "cubic_drag.py").write_text(
        LAW_FILE.replace("signals[s.LOAD_NM] +=", "parameters = parameters + 1.0\n    _ =")
    )
    assert "effect 'cubic_drag': its kernel does not compile" in said(own, REGISTER + TORQUE)


DRAG = LAWS["quadratic_drag"]


def own_copy(**changes):
    return replace(DRAG, **{"name": "my_drag", **changes})


@pytest.mark.parametrize(
    ("law", "said"),
    [
        (own_copy(name="My drag"), "its name: small letters"),
        (own_copy(name="unknown_drag"), "not beginning with 'unknown'"),
        (own_copy(parameters=()), "at least one strength"),
        (own_copy(parameters=DRAG.parameters * 2), "no name twice"),
        (
            own_copy(parameters=(*DRAG.parameters, Parameter("place", "rev", SHAPE, 0.0, 1.0, 2.0, ""))),
            "parameter 'place': typical 2 is outside 0 to 1 rev",
        ),
        (
            own_copy(parameters=(*DRAG.parameters, Parameter("more", "Nm", STRENGTH, 0.0, 1.0, 1.0, "", "size"))),
            "parameter 'more' needs 'size', which is none of its shapes: none",
        ),
        (own_copy(kernel=lambda signals, parameters, memory: None), "put @njit above it"),
        (own_copy(name="cogging"), "fffo-drive has a law of this name"),
    ],
)
def test_what_contradicts_itself_is_not_registered(law, said):
    laws = Laws(dict(LAWS))
    with pytest.raises(DocumentError, match=said):
        laws.add(law, "file own.py")
    assert list(laws) == list(LAWS)


def test_what_is_no_law_is_refused_and_the_same_law_twice_is_not():
    with pytest.raises(DocumentError, match="law: str where a Law"):
        register_law("cogging")
    laws = Laws({"cogging": LAWS["cogging"]})
    laws.add(own_copy(), "file own.py")
    laws.add(own_copy(meaning="another one"), "file own.py")
    assert laws["my_drag"].meaning == "another one"
    assert laws.brought_by("my_drag") == "file own.py"
    assert laws.brought_by("cogging") is None
