"""The verdict: what may be named, and which of four answers the diagnosis gives. It is set here and nowhere else."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from missionsim.identify.findings import Finding, Structure

Verdict = Literal["effects_found", "nothing_missing", "ambiguous", "unexplained_structure"]


def decide(
    effects: Sequence[Finding],
    structures: Sequence[Structure],
    demoted: Sequence[str] = (),
    *,
    law: bool = False,
    execution: Sequence[Finding] = (),
    averages: Sequence[Structure] = (),
) -> Verdict:
    """The verdict on a battery.

    Parameters
    ----------
    effects : sequence of Finding
        Effects that are named.
    structures : sequence of Structure
        What remains in the residual.
    demoted : sequence of str
        Effects that the model keeps and does not name because of a structure.
    law : bool
        Whether a law that the library does not hold describes what remains.
    execution : sequence of Finding
        How the robot drove otherwise than planned.
    averages : sequence of Structure
        Errors of averages over runs or over one kind of motion. Beside an effect they are told, but do not outweigh it:
        both tests are coarse.

    Returns
    -------
    str
        ``unexplained_structure`` where something remains and no name holds against it; ``ambiguous`` where an effect
        has rivals; ``effects_found``; ``nothing_missing``.
    """
    # a name beside something louder that puts it in doubt would be a confident guess
    if structures and (demoted or not effects):
        return "unexplained_structure"
    # one unsure name makes the whole answer a question: what to drive is told with it
    if not all(effect.is_clear for effect in effects):
        return "ambiguous"
    if law:
        return "unexplained_structure"
    # what remains beside names that hold is told, and takes nothing back
    if effects or execution:
        return "effects_found"
    return "unexplained_structure" if averages else "nothing_missing"
