"""Round after round: diagnose, add the best-supported effect, compare again, until nothing is left to find."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace

from missionsim.diagnose import words
from missionsim.diagnose.adopt import write
from missionsim.diagnose.diagnosis import diagnose_battery
from missionsim.diagnose.examine import NO_PRIOR_SD, Examined, Subject, examine, prior_before
from missionsim.diagnose.heldout import Models
from missionsim.diagnose.leftover import fed_note, straight_note
from missionsim.diagnose.meter import Metered, base_is_off, metered
from missionsim.diagnose.proposed import as_finding, law_name, with_candidate, with_law
from missionsim.diagnose.sentences import Asked, advice
from missionsim.diagnose.split import Split, lacking
from missionsim.diagnose.waterfall import Step, by_chance, noise_floor, step_of, worse_note
from missionsim.files import Json
from missionsim.fit.final import CLEARLY, FinalFit
from missionsim.identify.align import Clock
from missionsim.identify.findings import BatteryDiagnosis, Finding
from missionsim.identify.predictive import least_squares_clock
from missionsim.identify.settings import HALVED, Settings
from missionsim.inputs.edit import Editing
from missionsim.inputs.loading import robot_from_text

MOST_ROUNDS = 8
MOVED = 0.1
"""Change of a size, in parts of it, that is told."""
CLOCK_MOVES_S = 0.05
"""Change of delay or lag from which the fits are made anew."""

Ask = Callable[[Finding, BatteryDiagnosis], bool]


@dataclass(frozen=True)
class Improved:
    """What came of it."""

    battery: str
    text: str
    """The robot file with everything that was added."""
    added: tuple[str, ...]
    declined: tuple[str, ...]
    steps: tuple[Step, ...]
    heldout: bool
    """Whether the steps are of runs that were not used to fit."""
    first: BatteryDiagnosis
    last: BatteryDiagnosis
    """Both: before anything was added, and after."""
    _: KW_ONLY
    stopped: str
    """Why it ended, in words."""
    untested: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """Held-out runs that the steps leave out, and the columns that they lack, on which what was added depends."""
    base_alone: bool = False
    """Whether nothing was added, but the base fitted anew, since held-out runs are predicted clearly better so."""
    late: Metered | None = None
    """The meter that alone was written, where nothing was added and the base is left as it was."""
    written: tuple[Finding, ...] = ()
    """What was added, as the file has it."""
    asked: Mapping[str, float] = field(default_factory=dict)
    """Part of the energy that each had when it came in, before what came later."""
    formulas: Mapping[str, str] = field(default_factory=dict)
    """Of the laws that were added."""

    @property
    def told(self) -> str:
        """What was added, each with the size that it has in the file, in words."""
        parts = []
        for one in self.written:
            before, now = self.asked.get(one.effect, one.net), one.net
            changed = abs(now - before) > MOVED * max(abs(now), abs(before))
            more = f", {100 * before:.1f} % when it was found" if changed else ""
            size = f"({100 * now:.1f} % of the energy{more})".replace("-", "−")
            formula = f", {self.formulas[one.effect]}" if one.effect in self.formulas else ""
            parts.append(f"{one.effect}{formula} {size}")
        if self.late is not None:
            return "no effect, the meter alone"
        return ", ".join(parts or self.added) or "nothing"

    def to_json(self) -> Json:
        """As ``missionsim improve --json`` has a battery."""
        return {
            "added": list(self.added),
            "written": [one.to_json() for one in self.written],
            "declined": list(self.declined),
            "base_alone": self.base_alone,
            "meter": self.late and self.late.meter._asdict(),
            "stopped": self.stopped,
            "on_heldout_runs": self.heldout,
            "untested": {run: list(columns) for run, columns in self.untested.items()},
            "steps": [step._asdict() for step in self.steps],
            "worse": self.worse or None,
            "first": self.first.to_json(),
            "last": self.last.to_json(),
        }

    @property
    def complete(self) -> bool:
        """Whether nothing remains to be told."""
        return self.stopped == f"{words.NOTHING_LEFT}."

    @property
    def worse(self) -> str:
        """In words, that the file predicts these runs worse; empty where it does not, or where nothing was added."""
        return worse_note(self.steps[:-1], self.added, self.heldout) if self.added else ""

    def advice(self, asked: Asked, several: bool = False) -> tuple[str, str]:
        """What predicts these runs better than the file that was made, in words, and the command for it; `several`:
        whether there are more batteries.

        Both empty where nothing is better; the command alone where the file as it was given is.
        """
        return advice(self, asked, several)


@dataclass(frozen=True)
class State:
    """What some rounds have come to."""

    text: str
    """The robot file with what was added."""
    given: str
    """The file as it was given, with the laws as candidates."""
    models: Models
    seen: Examined
    last: BatteryDiagnosis
    """Both: of `text`."""
    taken: tuple[Finding, ...] = ()

    def believed(self) -> Models:
        """What is seen and cannot be named is not added; the base has to take its part, not what is added."""
        free = self.last.unsure and self.models.unheld.of_others(()) < (1.0 - CLEARLY) * self.models.of_others(())
        return self.models.unheld if free else self.models


class Rounds:
    """What the user agrees to goes in, round after round: what the library names, then laws."""

    def __init__(
        self, start: State, split: Split, battery: str, settings: Settings, ask: Ask, priors: Mapping[str, float]
    ) -> None:
        self.state = self.library = start
        self.split, self.battery, self.settings, self.ask, self.priors = split, battery, settings, ask, priors
        self.declined: list[str] = []
        self.alike = [{one.effect, *one.alike} for one in start.seen.found.effects]
        """What could not be told apart at first; one of these in the file tells no more, nor a law in its place."""
        self.stood_in: set[str] = set()
        """Effects in whose place a law went in."""
        self.nothing = Counter[str]()
        """How often each came to nothing beside others."""
        self.by_law: dict[str, str] = {}
        """Formulas of the laws that went in."""
        self.asked: dict[str, float] = {}
        """Part of the energy that each had when it came in."""
        self.again = False
        self.timed: State | None = None
        """Whose clock was looked at: it is the same after a round in which nothing went in."""
        self.aside: State | None = None
        """With what the library named beside a law and that law as it was, while another form of it is looked for."""

    def best(self) -> State:
        """The last state, or one before it that predicts parts of the runs clearly better from the others."""
        states = []
        for turn in range(MOST_ROUNDS + 1):
            self.reclock()
            if self.state.taken:
                states.append((self.state.models.of_others(self.state.taken), self.state))
            if turn == MOST_ROUNDS:
                break
            if self.of_library() or self.of_law():
                continue
            # what was put aside, where it predicts other runs better than all states that came instead
            aside, self.aside = self.aside, None
            least = (1.0 - CLEARLY) * min((error for error, _ in states), default=0.0)
            if aside is None or aside.models.of_others(aside.taken) > least:
                break
            self.state = aside
        best = min(states, key=lambda one: one[0], default=None)
        # what came later, or was looked for once more, may predict other runs less well
        return best[1] if best is not None and best[0] < (1.0 - CLEARLY) * states[-1][0] else self.state

    def finished(self) -> tuple[State, Subject, BatteryDiagnosis]:
        """The best state, its robot, and what `diagnose` says of that; if it names more, what comes of that."""
        made, last = self.as_written(end := self.best())
        if end.taken and self.named(last):
            self.state = replace(end, last=last)
            made, last = self.as_written(end := self.best())
        return end, made, last

    def as_written(self, state: State) -> tuple[Subject, BatteryDiagnosis]:
        """The robot of a file, and what `diagnose` says of it: it knows nothing of the base beside these logs."""
        made = Subject.of(robot_from_text(state.text))
        if not state.taken:
            return made, state.last
        seen = state.seen.known_as(made, self.split)
        return made, diagnose_battery(made, self.split, self.battery, self.settings, seen=seen)

    def reclock(self) -> None:
        """Go on at the clock that is seen beside what was added, if left-out runs say so. No meter is ahead of the
        motion but one whose readings stay, by what they stay for."""
        new, state = self.state.last.clock, self.state
        old, runs = state.models.clock, len(state.models.runs)
        if state is self.timed or not state.taken or new is None:
            return
        self.timed = state
        enough = (1.0 - CLEARLY) * state.models.of_others(state.taken)
        least = min(old.delay_s, *(-run.reading_s(self.battery) for run in state.models.runs))
        for one in (self.near(new, least), new):
            clock = replace(one, delay_s=max(one.delay_s, least)).in_all(runs)
            if max(abs(clock.delay_s - old.delay_s), abs(clock.lag_s - old.lag_s)) < CLOCK_MOVES_S:
                continue
            later = replace(state.models, clock=clock, _fits={})
            if later.of_others(state.taken) < enough:
                self.library = replace(self.library, models=replace(self.library.models, clock=clock, _fits={}))
                self.state = replace(state, models=later)
                self.settle(*self.together(self.state, state.taken))
                return

    def near(self, clock: Clock, earliest_s: float) -> Clock:
        """Where least squares errs least near it: that of a base far from right was looked for by coarse steps."""
        choice = self.state.seen.found.choice
        if choice.forward is None:
            return clock
        return least_squares_clock(choice.model.source, clock, choice.model.chosen, earliest_s)

    @property
    def as_well(self) -> set[str]:
        """What went in, and what could not be told from it at first."""
        inside = {effect.effect for effect in self.state.taken}
        return inside.union(*(names for names in self.alike if names & (inside | self.stood_in)))

    def named(self, seen: BatteryDiagnosis) -> list[Finding]:
        """What a diagnosis names that was neither added nor declined, nor could be told from what was."""
        # what came to nothing beside some may be something beside others
        known = {*(name for name, n in self.nothing.items() if n > 1), *self.as_well, *self.declined}
        return [effect for effect in seen.effects if effect.is_clear and effect.effect not in known]

    def of_library(self) -> bool:
        """Add what the library names anew; whether there was something."""
        state, new = self.state, []
        for effect in self.named(state.last):
            if self.ask(effect, state.last):
                new.append(effect)
                self.asked.setdefault(effect.effect, effect.net)
            else:
                self.declined.append(effect.effect)
        found = [effect for effect in new if effect.effect not in self.by_law]
        taken = [*state.taken, *new]
        if found and not self.again:  # a law found without them has another form beside them: once more without it
            self.again = bool(self.by_law)
            if self.again:
                counted = self.nothing.copy()
                self.settle(*self.together(state, taken))
                self.aside, self.nothing = self.state, counted
            state = replace(state, given=self.library.given, models=self.library.models)
            taken = [*(effect for effect in state.taken if effect.effect not in self.by_law), *found]
        if new:
            self.state = state
            self.settle(*self.together(state, taken))
        return bool(new)

    def of_law(self) -> bool:
        """Add a law, once the library has no more; whether one was left to try."""
        state, battery = self.state, self.battery
        offered = (p for p in state.last.proposed_laws if not p.open)
        # what is left of the form of a law that went in is no law of its own, unless most of the error is
        forms = {name.removesuffix("_again") for name in self.by_law}
        offered = (p for p in offered if p.far_better or law_name(p.first.formula) not in forms)
        law = next((p for p in offered if p.first.formula not in {*self.declined, *self.nothing}), None)
        if law is None:
            return False
        formula = law.first.formula
        if not self.ask(as_finding(law), state.last):
            self.declined.append(formula)
            return True
        given, name = with_candidate(state.given, battery, formula)
        kept = [effect for effect in state.taken if effect.effect not in law.instead_of]
        beside = replace(state, given=given, models=with_law(state.models, name, formula))
        found, fitted = self.together(beside, [*kept, replace(as_finding(law), effect=name)], surest=len(kept))
        k = next((one.parameters["k"] for one in found if one.effect == name), None)
        # its size was found beside everything that is seen: without what these data cannot tell, it may be another,
        # which other runs must show clearly then
        other = bool(state.last.unsure) and k is not None and max(k.low, law.first.low) > min(k.high, law.first.high)
        shown = other and beside.models.of_others(found) < HALVED * state.models.of_others(state.taken)
        if k is None or k.low <= 0.0 <= k.high or (other and not shown):
            self.nothing[formula] += 1
            return True
        self.by_law[name] = formula
        self.stood_in |= {*law.instead_of}
        self.asked[name] = law.energy_share
        self.state = beside
        self.settle(found, fitted)
        return True

    def together(self, state: State, effects: Sequence[Finding], surest: int = 0) -> tuple[list[Finding], FinalFit]:
        """Effects and base fitted together, from the file as it was given, so that no round moves one on from where
        another left it. What comes to nothing beside the others goes, but never the surest."""
        names = [effect.effect for effect in effects]
        told, fitted = state.believed().certain([effects[surest], *effects[:surest], *effects[surest + 1 :]])
        self.nothing.update({*names} - {effect.effect for effect in told})
        return sorted(told, key=lambda effect: names.index(effect.effect)), fitted

    def left(self, taken: Sequence[Finding]) -> list[str]:
        """What came to nothing, and did not go in later beside others."""
        return sorted(self.nothing.keys() - {effect.effect for effect in taken})

    def settle(self, effects: Sequence[Finding], fitted: FinalFit) -> None:
        """Write the effects into the file and diagnose it."""
        given, models = self.state.given, self.state.models
        text, _ = write(given, models, effects, fitted, self.split)
        # the file's own values came from these logs: what was known before them stays the prior
        subject = Subject.of(robot_from_text(text))
        terms = (term for term in subject.model.of(self.battery) if not term.base)
        added = {term.name_of(name): NO_PRIOR_SD for term in terms for name in term.parameters}
        again = replace(subject, priors={**added, **self.priors})
        tried = {name for name, n in self.nothing.items() if n > 1} | {*self.declined}
        seen = examine(again, self.split, self.battery, self.settings, models.clock)
        last = diagnose_battery(again, self.split, self.battery, self.settings, seen=seen, tried=tried)
        self.state = State(text, given, models, seen, last, tuple(effects))


def improve(text: str, split: Split, battery: str, settings: Settings, ask: Ask) -> Improved:
    """Improve the text of a robot file for one battery.

    What a diagnosis names goes in together, with the numbers that it names; the error of each step is that of a robot
    file, as `missionsim compare` measures it.

    Parameters
    ----------
    text : str
        Robot file.
    ask : callable
        ``(finding, diagnosis) -> bool``: whether to add it.
    """
    start = Subject.of(robot_from_text(text))
    # what was known before these logs; nothing of parameters that were fitted to them by `calibrate`
    priors = {
        term.name_of(name): prior_before(start, parameter, split.train)
        for term in start.model.of(battery)
        for name, parameter in term.parameters.items()
    }
    seen = examine(start, split, battery, settings)
    if seen.features.given_sd:  # refuted
        priors = dict.fromkeys(priors, NO_PRIOR_SD)
    first = diagnose_battery(start, split, battery, settings, seen=seen)
    rounds = Rounds(State(text, text, seen.models, seen, first), split, battery, settings, ask, priors)
    end, made, last = rounds.finished()
    text, models, taken = end.text, end.models, end.taken
    added = [term.effect for term in made.model.of(battery) if not term.base]
    measured = [log for log in split.heldout if battery in log.power_w]
    untested = lacking(measured, added, start.model.batteries, models.runs)
    heldout = [log for log in measured if log.run not in untested]
    powers = {"before": start.model, "recalibrated": models.fit(()).model}
    last_models = end.believed()
    if heldout and not taken and last_models is not models:
        powers["base without priors"] = last_models.fit(()).model
    # as add-effect writes one of several: its size as it was found beside the others, the base fitted again
    powers |= {f"+ {e.effect}": models.fit(taken[: i + 1], fixed=True).model for i, e in enumerate(taken[:-1])}
    if taken:
        powers[f"+ {taken[-1].effect}"] = made.model
    runs = heldout or models.runs
    errors = {name: models.errors(power, runs) for name, power in powers.items()}
    steps = [step_of(name, one) for name, one in errors.items()]
    floor_pct, floor_w = noise_floor(last)
    # where much is unexplained the noise holds a part of it, and a model that errs by less shows that (`floor_note`)
    steps.append(Step("noise floor", floor_pct, min(floor_w, steps[-1].power_rmse_w)))
    doubted = last_models.leaning(taken, last_models.fit(taken)) if taken else ()
    late = None if taken else metered(models, runs, floor_pct)
    most_pct = by_chance(floor_pct, len(runs))[1]
    base_alone = bool(heldout) and not taken and base_is_off(steps[0], steps[-2], late, most_pct)
    if base_alone:
        text, _ = write(end.given, models, (), last_models.fit(()), split)
    elif late is not None:
        text = Editing(text).set_meter(battery, late.meter).text
        steps.insert(-1, late.step)
    return Improved(
        battery,
        text,
        tuple(effect.effect for effect in taken),
        tuple(rounds.declined),
        tuple(steps),
        bool(heldout),
        first,
        last,
        stopped=words.stopped(last, rounds.declined, rounds.left(taken), rounds.as_well, tested=not untested)
        + fed_note(last, battery, models.runs, heldout)
        + (straight_note(powers[f"+ {taken[-1].effect}"], models.runs, battery) if taken else "")
        + "".join(f" {one.effect}: {one.doubt}." for one in doubted if one.doubt),
        untested=untested,
        base_alone=base_alone,
        late=None if base_alone else late,
        written=doubted,
        asked=rounds.asked,
        formulas=rounds.by_law,
    )
