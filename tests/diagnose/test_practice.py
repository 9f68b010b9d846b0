"""Practice folders: a right name, an honest set with the experiment that separates it, a form that is not right."""

from __future__ import annotations

from pathlib import Path

import pytest

from missionsim.diagnose import diagnose_files, words
from missionsim.identify.findings import BatteryDiagnosis


def diagnosis(shared: Path, case: str) -> BatteryDiagnosis:
    folder = shared / "practice" / case
    return diagnose_files("pioneer3dx", [folder / "train"], holdout=[folder / "heldout"]).batteries["robot"]


@pytest.mark.long
def test_the_right_name_first_and_the_heldout_error_falls(shared: Path) -> None:
    found = diagnosis(shared, "payload-5pct")
    assert found.effects[0].effect == "payload"
    assert found.heldout is not None
    assert found.heldout.power_rmse_w["with_effects"] < 0.8 * found.heldout.power_rmse_w["nominal"]


@pytest.mark.long
@pytest.mark.usefixtures("effects_alone")
@pytest.mark.parametrize("case", ["a", pytest.param("b", marks=pytest.mark.study)])
def test_confounded_names_both_and_proposes_to_vary_one(shared: Path, case: str) -> None:
    found = diagnosis(shared, f"confounded-carpet-payload-{case}")
    assert found.verdict == "ambiguous"
    first = found.effects[0]
    assert {first.effect, *first.indistinguishable_from} == {"payload", "surface_rolling_resistance"}
    assert first.effect == "payload"  # twins, which rounding alone tells apart: the first of the library
    told = words.headline(found)
    assert "payload" in told
    assert "surface_rolling_resistance" in told
    assert "cannot tell" in told
    excluded = dict(words.report(found))["NOT SEEN"]
    assert "payload" not in excluded
    assert "surface_rolling_resistance" not in excluded
    experiment = found.next_experiments[0]
    if case == "a":  # two that rounding alone tells apart: the first of the library
        assert experiment.separation_after == found.next_experiments[1].separation_after
        assert experiment.do.startswith("drive straight")
    varied = {name for name in ("payload_kg", "surface") if len({part.get(name) for part in experiment.manoeuvre}) > 1}
    assert len(varied) == 1
    assert experiment.separation_now < 1.0
    assert experiment.separation_after > 5.0
    assert experiment.expected_power > 0.9


@pytest.mark.long
@pytest.mark.usefixtures("laws_at_once")
def test_a_form_that_the_library_does_not_have_is_not_named(shared: Path) -> None:
    found = diagnosis(shared, "outside-om_v2")
    assert found.verdict == "unexplained_structure"
    assert "turning_scrub" not in {effect.effect for effect in found.effects}
    assert "yaw_rate_rad_s" in found.unexplained.depends_on
    assert "turning_scrub" not in dict(words.report(found))["NOT SEEN"]  # it acts, only not in the library's form
    assert [law.certain for law in found.proposed_laws] == [("yaw_rate_rad_s",)]  # the law itself, in place of a drive


@pytest.mark.study  # of CSV logs from the little world: test_commands.py, tests/hidden_effects
def test_nothing_hidden_nothing_named(shared: Path) -> None:
    found = diagnosis(shared, "nothing-1")
    assert found.verdict == "nothing_missing"
    assert found.effects == ()
    assert "No evidence of anything missing" in words.headline(found)
