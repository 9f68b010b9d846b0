"""What comes with missionsim: effects, robots, schemas, examples, and every published figure beside ours."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cyclopts import App

from missionsim.cli.options import TERMINAL, OutFolder, Output
from missionsim.errors import InputError
from missionsim.files import fields_of, write_text
from missionsim.numerals import rounded
from missionsim.report.terminal import console, show_table, titled

if TYPE_CHECKING:
    from missionsim.published.figures import Item


effects_app = App(
    name="effects", help="The library of effects: equation, parameters, units, source.", help_format="plaintext"
)


def _describe(id: str) -> dict[str, Any]:
    from missionsim.effects.library import get_effect
    from missionsim.runs.covariates import logged_name

    family, _, name = id.partition(":")
    effect = get_effect(f"{family}:{name.strip('<>')}" if name else id, surfaces=("<surface>",))
    # what a log must have for its covariates; clocks and acceleration follow from that
    columns = {need: logged_name(need) for need in effect.needs}
    needs, derived = list(dict.fromkeys(columns.values())), [need for need, column in columns.items() if column != need]
    if name.startswith("<"):
        needs, derived = ([text.replace(name.strip("<>"), name) for text in texts] for texts in (needs, derived))
    return {
        "id": id,
        **fields_of(effect, "equation meaning"),
        "parameters": [fields_of(p, "name unit low high default meaning") for p in effect.parameters],
        "needs": needs,
        "derived": derived,
        "kind": "execution" if effect.execution else "power",
        "source": effect.source,
    }


def _needed(described: dict[str, Any]) -> str:
    return ", ".join([*(["a mission"] if described["kind"] == "execution" else []), *described["needs"]])


@effects_app.default
def list_effects(*, to: Output = TERMINAL) -> int:
    """List every effect of the library."""
    from missionsim.effects.library import effect_ids

    described = [_describe(id) for id in effect_ids()]
    to.emit({"schema": "missionsim.effects/1", "effects": described})
    if to.text:
        rows = [(d["id"], d["equation"], _needed(d) or "–") for d in described]
        show_table("Library of effects", ["effect", "power it adds", "needs in the log"], rows)
        console().print(
            "Acceleration, starts and clocks (moving time, time switched on) follow from those columns.\n"
            "missionsim effects show ID tells parameters, units and source of one."
        )
    return 0


@effects_app.command
def show(id: str, *, to: Output = TERMINAL) -> int:
    """Show one effect in full.

    Parameters
    ----------
    id
        Name of the effect, such as grade or component_power:kinect.
    """
    described = _describe(id)
    to.emit({"schema": "missionsim.effect/1", **described})
    if to.text:
        terminal = console()
        terminal.print(titled(id, f"  {described['meaning']}"))
        terminal.print(f"power   {described['equation']}")
        from_them = f"; derived from them: {', '.join(described['derived'])}" if described["derived"] else ""
        terminal.print(f"needs   {_needed(described) or 'nothing beside the power'}{from_them}")
        terminal.print(f"source  {described['source']}")
        rows = [(p["name"], p["unit"], f"{p['low']:g} … {p['high']:g}", p["meaning"]) for p in described["parameters"]]
        show_table("parameters", ["name", "unit", "range", "meaning"], rows)
    return 0


def robots(*, to: Output = TERMINAL) -> int:
    """List the shipped robots with their batteries, components and control schemes."""
    from missionsim.inputs import load_robot, shipped_robots

    described: list[dict[str, Any]] = []
    for name, path in shipped_robots().items():
        robot = load_robot(name)
        body = {"drive": robot.body.drive, "max_speed_m_s": robot.body.max_speed.value}
        parts = {
            "batteries": {key: fields_of(battery, "capacity_wh") for key, battery in robot.batteries.items()},
            "components": {key: fields_of(item, "units always_on") for key, item in robot.components.items()},
            "schemes": {key: list(item.navigation) for key, item in robot.schemes.items()},
            "motion_model": robot.motion.model if robot.motion is not None else None,
        }
        head = {**fields_of(robot, "name title"), "path": str(path), "sha256": robot.sha256}
        described.append({**head, **body, **parts, "sources": robot.sources})
    to.emit({"schema": "missionsim.robots/1", "robots": described})
    if to.text:
        rows = []
        for item in described:
            each = [f"{key} {rounded(value['capacity_wh'], 4)} Wh" for key, value in item["batteries"].items()]
            units = {key: value["units"] for key, value in item["components"].items() if not value["always_on"]}
            switched = ", ".join(key + f" ×{count}" * (count > 1) for key, count in units.items()) or "–"
            schemes = "\n".join(item["schemes"]) or "–"
            rows.append((item["name"], item["title"], "\n".join(each), switched, schemes))
        columns = ["robot", "what it is", "batteries", "components that switch", "control schemes"]
        show_table("Shipped robots", columns, rows)
    return 0


def schema(*kind: str, robot: str | None = None, out: OutFolder | None = None, to: Output = TERMINAL) -> int:
    """Write the JSON Schema of each kind of YAML file.

    An editor checks and completes a file whose first line is
    `# yaml-language-server: $schema=PATH/robot.schema.json`.

    Parameters
    ----------
    kind
        Kinds to write: robot, environment, mission, study, map, task. All of them by default.
    robot
        Shipped robot or robot file: the schemas then know its batteries, components and schemes and no others.
    out
        Folder for the files, made if need be. Without it, the schema of one kind goes to standard output.
    """
    from missionsim.inputs.loading import KINDS, load_robot
    from missionsim.inputs.schemas import schema as make
    from missionsim.inputs.schemas import schema_text

    spec = None if robot is None else load_robot(robot)
    kinds = tuple(dict.fromkeys(kind)) or tuple(KINDS)
    if len(kinds) > 1 and kind and out is None and to.json is None:
        raise InputError.single("several schemas need --out or --json", got=", ".join(kinds), allowed="--out DIR")
    made = {name: make(name, spec) for name in kinds}
    to.emit({"schema": "missionsim.schemas/1", "kinds": made})
    if out is not None:
        if out.exists() and not out.is_dir():
            raise InputError.single("--out must be a folder", got=str(out), allowed="a folder")
        for name in kinds:
            write_text(out / f"{name}.schema.json", schema_text(name, spec))
            if to.text:
                console().print(str(out / f"{name}.schema.json"), soft_wrap=True)
    elif to.json is None and len(kinds) == 1:
        print(schema_text(kinds[0], spec), end="")
    elif to.text:
        console().print("Kinds of YAML files: " + ", ".join(kinds))
        console().print("missionsim schema --out DIR writes a JSON Schema for each, missionsim schema KIND prints one.")
    return 0


def examples(*, out: OutFolder | None = None, to: Output = TERMINAL) -> int:
    """Write the missions, environments, example logs, maps, sites and pages that come with missionsim.

    The commands of README and of the pages run in that folder.

    Parameters
    ----------
    out
        Folder for the files, made if need be; files with another content are not overwritten. Without it, the files
        are listed.
    """
    from missionsim.inputs.loading import example_files, write_examples

    names = list(example_files()) if out is None else write_examples(out)
    to.emit({"schema": "missionsim.examples/1", "out": out, "files": names})
    if to.text:
        if out is None:
            for name in names:
                console().print(str(name), soft_wrap=True)
        else:
            terminal = console()
            terminal.print(f"{len(names)} files in {out}; try this there:", soft_wrap=True)
            terminal.print("  missionsim run missions/pioneer3dx/valve_patrol.yaml")
    return 0


MOST_COLUMNS, MOST_ROWS = 7, 16


def reproduce(*robots: str, out: OutFolder | None = None, no_pictures: bool = False, to: Output = TERMINAL) -> int:
    """Print every published figure of the four robots beside ours, with what agrees and what does not.

    Parameters
    ----------
    robots
        Shipped robots (pioneer3dx, khepera3, mecanum4, rover_tx2); all of them if none is named.
    out
        Write the tables as CSV, one Markdown page and the pictures into this folder.
    no_pictures
        Draw no pictures.
    """
    from missionsim.published.figures import ABOUT
    from missionsim.published.reproduce import papers_of, reproduce_paper, side_tables, to_json, write

    papers = papers_of(robots)
    items: dict[str, list[Item]] = {}
    with to.progress() as bar:
        task = bar.add_task("papers", total=len(papers))
        for paper in papers:
            items[paper] = reproduce_paper(paper)
            bar.advance(task)
        tables = {paper: side_tables(paper) for paper in papers}
    to.emit(to_json([item for found in items.values() for item in found], tables))
    if to.text:
        for paper, found in items.items():
            _print(paper, found)
            for name, rows in tables[paper].items():
                _print_side(ABOUT[paper].tables[name], rows)
    if out is not None:
        written = write(out, items, tables, not no_pictures)
        if to.text:
            console().print(f"{len(written)} files in {out}")
    return 0


def _print(paper: str, items: list[Item]) -> None:
    """One table of a paper, notes numbered under it."""
    from missionsim.published.figures import ABOUT
    from missionsim.published.reproduce import counts, footnotes, number

    references, notes = footnotes(items)
    rows = []
    for item, reference in zip(items, references, strict=True):
        f, apart = item.figure, "" if item.difference is None else f"{item.difference:+.2g}"
        rows.append([f.item, f.where, f.printed, number(item.ours), f.unit, apart, item.status, reference])
    heads = ["item", "where", ">published", ">ours", "unit", ">differ.", "status", ">note"]
    show_table(ABOUT[paper].title, heads, rows)
    terminal = console()
    for index, note in enumerate(notes, start=1):
        terminal.print(f"  {index:3d} {note}", style="dim")
    terminal.print(f"{counts(items)}.\n", style="bold")


def _print_side(words: str, rows: list[dict[str, Any]]) -> None:
    """A table beside the figures; wide ones stand on their side, long ones are in the CSV file only."""
    wide = len(rows[0]) > MOST_COLUMNS
    if len(rows) > (MOST_COLUMNS - 1 if wide else MOST_ROWS):
        return
    first, *columns = rows[0]
    body = [[f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in row.values()] for row in rows]
    if wide:
        body = [list(line) for line in zip([first, *columns], *body, strict=True)]
        first, columns = "", [str(i + 1) for i in range(len(rows))]
    show_table(words, [first, *(f">{column}" for column in columns)], body)
