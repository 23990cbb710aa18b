"""The table of symbols against the model file's keys and the units in names."""

from __future__ import annotations

from fffo_drive.model.parameters import FrictionModel, Quantity
from fffo_drive.symbols import FRICTION, SYMBOLS
from fffo_drive.units import unit_in


def test_friction_has_the_keys_of_the_model_file_in_their_order():
    keys = [key for key, field in FrictionModel.model_fields.items() if field.annotation is Quantity]
    assert list(FRICTION) == keys


def test_a_symbol_is_in_the_unit_that_its_name_ends_in_and_stands_for_one_number():
    for name, symbol in SYMBOLS.items():
        assert unit_in(name) in ("", symbol.unit), name
    assert len({symbol.symbol for symbol in SYMBOLS.values()}) == len(SYMBOLS)


def test_a_label_is_as_the_paper_prints_it():
    assert FRICTION["viscous_nm_per_rps"].label == "σ, viscous friction"
    assert FRICTION["coulomb_nm"].label == "Fc, Coulomb level"
