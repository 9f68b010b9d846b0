"""Fits to files of logs: the one way in which runs that are fitted are read, and `calibrate` of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from missionsim.files import Json
from missionsim.fit.calibrate import Calibration, NewRobot, calibrate_new, refit_robot
from missionsim.inputs.loading import load_robot
from missionsim.inputs.power import build_power_model
from missionsim.inputs.robot import RobotSpec
from missionsim.logs import Remark, describe, read_logs
from missionsim.runs.admit import admit
from missionsim.runs.run import Bounded, Run

AVERAGED = "averaged"
"""Kind of the remark that rows were averaged."""
Tell = Callable[[Sequence[str]], None]


def read_bounded(robot: RobotSpec | None, logs: Sequence[str | Path]) -> tuple[list[Run], list[str], str]:
    """The runs of some logs, checked against a robot; files that could not be read, and what was averaged, in words."""
    bounded = Bounded()
    refused: list[str] = []
    read, averaged = bounded.all(read_logs(list(logs), robot=robot, each=bounded, left_out=refused))
    return read, refused, averaged


def read_runs(robot: RobotSpec | None, logs: Sequence[str | Path]) -> tuple[list[Run], list[str]]:
    """The runs of some logs that a robot may learn from, and in words what was left out.

    Without a robot there is no model against which a run could be odd.
    """
    read, refused, averaged = read_bounded(robot, logs)
    runs, left_out = admit(read, None if robot is None else build_power_model(robot))
    if averaged:
        note = Remark(AVERAGED, "time_s", averaged, "shorter rows tell no more", "note")
        runs[0] = replace(runs[0], remarks=(*runs[0].remarks, note))
    return runs, [*left_out, *refused]


def refit_files(
    robot: str | Path, logs: Sequence[str | Path], battery: str | None = None, *, tell: Tell = lambda _: None
) -> Calibration:
    """`refit_robot` with the logs of some files. What is left out is told before the fit, which may fail for it."""
    runs, left_out = read_runs(load_robot(robot), logs)
    tell(left_out)
    return _told(refit_robot(str(robot), runs, battery), runs, runs, left_out)


def calibrate_files(robot: NewRobot, logs: Sequence[str | Path], *, tell: Tell = lambda _: None) -> Calibration:
    """`calibrate_new` with the logs of some files; without a battery it is the only one that they measure, or "robot".

    What is odd is seen against a model, of a new robot against that of all its runs.
    """
    runs, left_out = read_runs(None, logs)
    tell(left_out)
    measured = {name for run in runs for name in run.power_w}
    robot = replace(robot, battery=robot.battery or (measured.pop() if len(measured) == 1 else "robot"))
    made = calibrate_new(robot, runs)
    kept, odd = admit(runs, made.fit.model)
    if odd:
        tell(odd)
        made = calibrate_new(robot, kept)
    return _told(made, kept, runs, [*left_out, *odd])


def _told(made: Calibration, kept: Sequence[Run], read: Sequence[Run], left_out: Sequence[str]) -> Calibration:
    """With what the reading tells: remarks of the runs that were kept, and runs that were not."""
    averaged = [f"note: {one}" for run in read for one in run.remarks if one.kind == AVERAGED]
    return replace(made, remarks=(*describe(kept), *averaged, *made.remarks), left_out=tuple(left_out))


def calibration_json(made: Calibration, **more: str) -> Json:
    """What the command and the function of Python tell of a calibration."""
    batteries = {fit.battery: fit.to_json() for fit in made.fits}
    told = {"batteries": batteries, "remarks": list(made.remarks), "left_out": list(made.left_out)}
    return {"schema": "missionsim.calibration/1", **more, **told}
