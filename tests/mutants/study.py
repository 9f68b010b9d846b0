"""Change one line of the package at a time and see whether the quick tests notice; a study, not part of the suite.

``python -m tests.mutants.study [--room physics plan meter rules verdict search laws] [--list]``

A mutant is killed where the tests of its room fail. What survives is printed: a line that no quick test holds. Each
mutant runs in a copy of the repository's tests and package, so that the sources stay as they are.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
RULES = "tests/identify/test_thresholds.py tests/identify/test_rules.py"
TESTS = {
    "physics": "tests/effects tests/engine/test_closed_form.py tests/engine/test_closed_form_others.py",
    "plan": "tests/plan tests/engine/test_closed_form.py tests/engine/test_physical_sense.py",
    "meter": "tests/engine/test_batteries.py tests/engine/test_cut_short.py tests/engine/test_components.py",
    "rules": f"{RULES} tests/identify/test_numerics.py tests/identify/test_identify.py",
    "verdict": f"{RULES} tests/diagnose/test_factor.py tests/diagnose/test_leftover.py",
    "search": "tests/hidden_effects/test_quick.py",
    "laws": "tests/laws",
}
"""Quick tests of each room; tests/identify/test_method_page.py, which pins constants to the page, is left out."""


@dataclass(frozen=True)
class Mutant:
    """One change: the text `old`, which stands once in the file, becomes `new`."""

    room: str
    file: str
    old: str
    new: str


def _of(room: str, file: str, *changes: tuple[str, str]) -> list[Mutant]:
    return [Mutant(room, f"missionsim/{file}", old, new) for old, new in changes]


MUTANTS = [
    *_of(
        "physics",
        "physics/motion.py",
        ("return k * np.abs(rate)", "return k * rate"),
        ("return k * np.square(value)", "return k * np.abs(value)"),
        ("return k * np.abs(speed_m_s) ** 3", "return k * np.abs(speed_m_s) ** 2"),
        ("0.5 * density_kg_m3 * drag", "density_kg_m3 * drag"),
        ("+ regeneration * np.minimum(power_w, 0.0)", "- regeneration * np.minimum(power_w, 0.0)"),
        ("return k * mass_kg * accel_m_s2 * speed_m_s", "return k * mass_kg * accel_m_s2 * np.abs(speed_m_s)"),
        ("return mass_kg * GRAVITY_M_S2 * np.sin(slope_rad)", "return mass_kg * GRAVITY_M_S2 * np.cos(slope_rad)"),
        ("return k * payload_kg * np.abs(speed_m_s)", "return k * payload_kg"),
        ("np.exp(-np.asarray(moving_time_s) / tau_s)", "np.exp(np.asarray(moving_time_s) / tau_s)"),
        ("(reference_c - temp_ambient_c)", "(temp_ambient_c - reference_c)"),
        ("np.minimum(power_w - floor, 0.0)", "np.minimum(power_w, 0.0)"),
        ("return np.minimum(k, 1.0)", "return np.maximum(k, 1.0)"),
    ),
    *_of(
        "physics",
        "physics/electrical.py",
        ("return p2 * np.square(rate_hz) + p1 * rate_hz", "return p2 * np.square(rate_hz) - p1 * rate_hz"),
        ("np.exp(-f64(on_time_s) / tau_s)", "np.exp(-f64(on_time_s) * tau_s)"),
        ("np.asarray(frequency_hz) ** 3", "np.asarray(frequency_hz) ** 2"),
    ),
    *_of(
        "plan",
        "plan/kinematics.py",
        ("up, down = 2.0 * accel * distance", "up, down = accel * distance"),
        ("2.0 * decel * distance", "2.0 * accel * distance"),
        ("np.minimum(ceiling[..., :-1], ceiling[..., 1:])", "np.maximum(ceiling[..., :-1], ceiling[..., 1:])"),
        ("+ decel * np.square(before)", "+ accel * np.square(before)"),
        ("np.maximum(np.minimum(free, limit)", "np.maximum(np.maximum(free, limit)"),
        ("falling = (peak - after) / decel", "falling = (peak - after) / accel"),
        ("cruising = np.where(free > limit", "cruising = np.where(free < limit"),
        ("-decel + zero]", "decel + zero]"),
        ("[[(size / top, top, 0.0)]", "[[(size * top, top, 0.0)]"),
        ("np.square(after)) / (2 * decel)", "np.square(after)) / (2 * accel)"),
    ),
    *_of(
        "meter",
        "engine/meter.py",
        ("dock.power_w.get(name, 0.0) if dock else 0.0", "0.0"),
        ("below & (loads.charging == 0)", "below"),
        ("0.0 if state < reserve else", "0.0 if state > reserve else"),
        ("+ time, name, kind", ", name, kind"),
    ),
    *_of(
        "meter",
        "engine/batteries.py",
        ("net = loads.energy_j - loads.charged_j", "net = loads.energy_j + loads.charged_j"),
        ("full = self.charger_w * self.line.duration_s", "full = self.charger_w"),
        ("if at_start <= 0.0 < state - level", "if at_start > 0.0 < state - level"),
        ("return -current / self.charge_c", "return -2.0 * current / self.charge_c"),
        ("** (self.peukert - 1.0)\n        return", "** self.peukert\n        return"),
        ("extra = float(loads.charger_w[interval]) if", "extra = 0.0 if"),
        (
            "return float(time) if 0.0 <= time <= horizon_s else None",
            "return float(time) if time <= horizon_s else None",
        ),
    ),
    *_of(
        "rules",
        "identify/settings.py",
        ("ALPHA = 0.002", "ALPHA = 0.2"),
        ("min_share: float = 0.0065", "min_share: float = 0.0001"),
        ("recalibration_limit: float = 4.0", "recalibration_limit: float = 400.0"),
        ("ONE_RUN_PART = 0.05", "ONE_RUN_PART = -100.0"),
        ("WORSE_ENERGY_LEVEL = 0.01", "WORSE_ENERGY_LEVEL = 1.1"),
        ("FAINT_NATS = 50.0", "FAINT_NATS = 0.0"),
        ("UNUSUAL_GAIN = 0.03", "UNUSUAL_GAIN = 3.0"),
        ("ODDS_NATS = 4.6", "ODDS_NATS = -1e9"),
        ("LINE_RATIO = 8.0", "LINE_RATIO = 8e9"),
        ("PROMISING = 0.5", "PROMISING = 1.0"),
        ("JOINT_NATS = 0.5", "JOINT_NATS = 5.0"),
        ("FRESH_NATS = 2.0", "FRESH_NATS = 1e9"),
        ("MOST_TRIPLES = 20_000", "MOST_TRIPLES = 0"),
        ("BETWEEN_PART = 0.1", "BETWEEN_PART = 0.0"),
        ("SAME_COLUMN = 0.995", "SAME_COLUMN = 2.0"),
        ("NOISY_SLOPE = 2.0", "NOISY_SLOPE = 1.0"),
        ("RIVAL_PART = 0.5", "RIVAL_PART = 1e9"),
        ("KEPT_PART = 0.7", "KEPT_PART = 0.0"),
        ("ACTS_PART = 0.1", "ACTS_PART = 0.0"),
        ("EXTRA_EFFECT_NATS = 4.0", "EXTRA_EFFECT_NATS = 1e9"),
        ("BESIDE_RUN_LEVEL = 0.005", "BESIDE_RUN_LEVEL = 1.0"),
        ("SUPPORT_S = 8.0", "SUPPORT_S = 0.0"),
        ("FEWEST_HATS = 3", "FEWEST_HATS = 0"),
        ("STANDS = 0.5", "STANDS = 0.0"),
        ("SLOW_NOISE = 0.03", "SLOW_NOISE = 1e9"),
        ("AS_MUCH = 0.9", "AS_MUCH = 0.0"),
    ),
    *_of("search", "identify/settings.py", ("TRIED = 2", "TRIED = 1"), ("GLANCE = 0.6", "GLANCE = 0.0")),
    *_of(
        "laws",
        "laws/gates.py",
        ("LEAST_RISE = 6.0", "LEAST_RISE = -1e9"),
        ("LEAST_BETTER = 0.98", "LEAST_BETTER = 1.0"),
        ("FEW_BETTER = 0.95", "FEW_BETTER = 0.98"),
        ("abs(share) >= LEAST_SHARE", "True"),
    ),
    *_of(
        "laws",
        "laws/search.py",
        ("SEEDS = 3", "SEEDS = 1"),
        ("BENDS = 4", "BENDS = 0"),
        ("HARDLY_WORSE = 1.03", "HARDLY_WORSE = 1e9"),
        ("NEEDED_ERROR = 1.02", "NEEDED_ERROR = 1.0"),
        ("REPEATS = 1.5", "REPEATS = 0.0"),
        ("CLOSE_ERROR = 1.005", "CLOSE_ERROR = 1.0"),
    ),
    *_of(
        "laws",
        "laws/proposal.py",
        ("\nALIKE = 0.06", "\nALIKE = 0.0"),
        ("CLEARLY = 0.985", "CLEARLY = 1.0"),
        ("REPLACED = 0.35", "REPLACED = 0.0"),
        ("AKIN = 0.4", "AKIN = 1e9"),
        ("SHRUNK = 0.75", "SHRUNK = 1e9"),
        ("NO_WORSE = 1.01", "NO_WORSE = 1e9"),
        ("OWN_METER = 0.99", "OWN_METER = 2.0"),
    ),
    *_of("laws", "laws/adapter.py", ("CLOCK_NATS = 15.0", "CLOCK_NATS = 1e9")),
    *_of("laws", "laws/factors.py", ("NOISE_PART = 0.1", "NOISE_PART = 0.0")),
    *_of(
        "rules",
        "identify/rules.py",
        ("evidence.gain > nats_needed(tail)", "True"),
        ("evidence.p_robust < 2.0 * tail", "True"),
        ("abs(evidence.share) > settings.min_share", "True"),
        ("alone is None or bool(driven_for(model, column)[alone])", "True"),
        ("not abs(shift) <= settings.recalibration_limit", "True"),
        ('"runs": left < 1.0', '"runs": True'),
        ("if column in forms:", "if False:"),
        ('if candidate.effect.partition(":")[0] in STEADY_LOADS:', "if False:"),
        ("if any(not stands_without(model, column, s) for s in others):", "if False:"),
    ),
    *_of(
        "rules",
        "identify/evidence.py",
        (
            "np.where((constraints.sign == 0) | beside, 2.0, 1.0)",
            "np.where((constraints.sign == 0) | beside, 1.0, 1.0)",
        ),
        ("/ np.sqrt(number)", ""),
        ("inflation @ score**2", "np.ones_like(score) @ score**2"),
    ),
    *_of(
        "verdict",
        "identify/verdict.py",
        ("if structures and (demoted or not effects):", "if structures:"),
        ("if not all(effect.is_clear for effect in effects):", "if False:"),
        ("    if law:\n", "    if False:\n"),
        ("if effects or execution:", "if effects:"),
        ('"unexplained_structure" if averages else "nothing_missing"', '"nothing_missing"'),
    ),
    *_of(
        "verdict",
        "identify/simpler.py",
        ("const.LEVEL_SHARE or part < const.AS_MUCH", "const.LEVEL_SHARE or part < 2.0"),
        ("abs(plain_ratio(source) - 1.0) > const.AT_LEVEL", "True"),
    ),
]


def survives(mutant: Mutant, folder: Path, python: str) -> bool:
    """Whether the tests of its room pass with the mutant in place."""
    path = folder / mutant.file
    before = path.read_text(encoding="utf-8")
    assert before.count(mutant.old) == 1, f"{mutant.file}: '{mutant.old}' stands there {before.count(mutant.old)} times"
    path.write_text(before.replace(mutant.old, mutant.new), encoding="utf-8")
    try:
        command = [python, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *TESTS[mutant.room].split()]
        environment = os.environ | {"PYTHONPATH": str(folder), "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, check=False)
        return done.returncode == 0
    finally:
        path.write_text(before, encoding="utf-8")


def main() -> int:
    """Run the mutants and print those that survive."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--room", nargs="*", choices=list(TESTS), default=list(TESTS))
    parser.add_argument("--list", action="store_true", help="check that each text stands where it should, run nothing")
    options = parser.parse_args()
    todo = [m for m in MUTANTS if m.room in options.room]
    if options.list:
        wrong = [m for m in todo if (ROOT / m.file).read_text(encoding="utf-8").count(m.old) != 1]
        for m in wrong:
            print(f"{m.file}: '{m.old}' does not stand there once")
        print(f"{len(todo)} mutants")
        return 1 if wrong else 0
    left: list[Mutant] = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "copy"
        skipped = shutil.ignore_patterns(".git", ".venv", "__pycache__", "results", ".mypy_cache", ".ruff_cache")
        shutil.copytree(ROOT, folder, ignore=skipped)
        for number, mutant in enumerate(todo, 1):
            start = time.monotonic()
            alive = survives(mutant, folder, sys.executable)
            left += [mutant] * alive
            told = "SURVIVES" if alive else "killed"
            print(
                f"{number}/{len(todo)} {told} {mutant.file}: {mutant.old!r} ({time.monotonic() - start:.0f} s)",
                flush=True,
            )
    print(f"{len(todo) - len(left)} of {len(todo)} killed")
    return 0 if len(left) <= 0.1 * len(todo) else 1


if __name__ == "__main__":
    sys.exit(main())
