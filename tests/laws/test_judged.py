"""Which of the forms that were found stands first."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from missionsim.laws import gates, proposal
from missionsim.laws.grammar import Factor, Grammar
from missionsim.laws.search import Scored


@pytest.mark.parametrize(("best_is_near", "first"), [(True, (1,)), (False, (0,))])
def test_a_best_form_whose_sign_is_wrong_among_the_others_does_not_stand_first(
    monkeypatch: pytest.MonkeyPatch, best_is_near: bool, first: tuple[int, ...]
) -> None:
    grammar = Grammar((Factor("a", "a", "a"), Factor("b", "b**2", "b²", 1)), ())

    def fitted(form: tuple[int, ...]) -> SimpleNamespace:
        return SimpleNamespace(form=form, errors=SimpleNamespace(with_law=1.0 if form == (0,) else 0.9))

    near = [Scored((0,), 50.0, 0.1, 45.0)] + [Scored((1,), 50.0, 0.1, 45.0)] * best_is_near
    search = SimpleNamespace(grammar=grammar, fit=fitted, settled=lambda one: one)
    monkeypatch.setattr(proposal, "gates", lambda one: one.form)
    kept, _, chosen, seen = proposal._judged(search, SimpleNamespace(best=fitted((1,)), near=tuple(near)))
    assert kept[0].form == chosen.form == seen == first


@pytest.mark.parametrize(("factors", "acting", "held"), [(3, 2, False), (3, 3, True), (2, 2, True), (1, 1, True)])
def test_a_product_of_three_needs_three_runs_in_which_it_acts(
    monkeypatch: pytest.MonkeyPatch, factors: int, acting: int, held: bool
) -> None:
    monkeypatch.setattr(gates, "_robust", lambda *_: (0.1, 0.005))
    errors = SimpleNamespace(without=2.0, with_law=1.0, better=acting, acting=acting)
    model = SimpleNamespace(squares=None, design=SimpleNamespace(runs=[slice(0, 1)] * acting))
    law = SimpleNamespace(model=model, column=0, errors=errors, rise=80.0, penalty=5.0, form=tuple(range(factors)))
    passed = gates.gates(law).passed
    assert passed.pop("several runs") is held
    assert all(passed.values())
