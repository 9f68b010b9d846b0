"""`missionsim schema`: JSON Schema of each kind of YAML file."""

from __future__ import annotations

from missionsim.cli.options import TERMINAL, OutFolder, Output
from missionsim.report.terminal import console


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
    from missionsim.errors import InputError
    from missionsim.files import write_text
    from missionsim.inputs.loading import load_robot
    from missionsim.inputs.schemas import schema as make
    from missionsim.inputs.schemas import schema_kinds, schema_text

    spec = None if robot is None else load_robot(robot)
    kinds = kind or schema_kinds()
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
