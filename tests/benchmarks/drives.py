"""The patrol in other simulators, each in steps of a second; times are of stepping alone, without set-up."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from missionsim.engine.outcome import RunResult
from tests.benchmarks import patrol

Measured = tuple[float, float]
"""Seconds of the processor, and a figure of the same mission that this tool gives."""


def basilisk(result: RunResult, folder: Path) -> Measured:
    """Basilisk: a sink of power for each component and the motors, two batteries; their energy [J]."""
    from Basilisk.simulation import simpleBattery, simplePowerSink
    from Basilisk.utilities import SimulationBaseClass, macros

    sim = SimulationBaseClass.SimBaseClass()
    sim.CreateNewProcess("robot").addTask(sim.CreateNewTask("power", macros.sec2nano(1.0)))
    stores, sinks = [], []
    for name in result.batteries:
        battery = simpleBattery.SimpleBattery()
        battery.storageCapacity = battery.storedCharge_Init = full = 3.6e9
        for terms in result.energy_j[name].values():
            sink = simplePowerSink.SimplePowerSink()
            battery.addPowerNodeToModel(sink.nodePowerOutMsg)
            sim.AddModelToTask("power", sink)
            sinks.append((sink, -sum(terms.values()) / result.timeline.duration_s))
        sim.AddModelToTask("power", battery)
        stores.append(battery)
    sim.InitializeSimulation()
    begun = time.process_time()
    for row, end in enumerate(result.timeline.start_s + result.timeline.duration_s):
        for sink, watts in sinks:
            sink.nodePowerOut = watts[row]
        sim.ConfigureStopTime(macros.sec2nano(end))
        sim.ExecuteSimulation()
    spent = time.process_time() - begun
    return spent, sum(full - battery.batPowerOutMsg.read().storageLevel for battery in stores)


def speeds(result: RunResult) -> tuple[np.ndarray, np.ndarray]:
    """Each second of the mission and the speed at it."""
    line = result.timeline
    time_s = np.arange(0.0, result.duration_s)
    row = np.clip(np.searchsorted(line.start_s, time_s, side="right") - 1, 0, None)
    speed = line.columns["speed_m_s"][row] + line.rates["speed_m_s"][row] * (time_s - line.start_s[row])
    return time_s, np.where(speed < 1e-9, 0.0, speed)


def fastsim(result: RunResult, folder: Path) -> Measured:
    """FASTSim: an electric car follows the speeds second by second; the way driven [m]."""
    import fastsim

    time_s, speed = speeds(result)
    cycle = fastsim.Cycle.from_dict(
        {"name": "patrol", "time_seconds": time_s.tolist(), "speed_meters_per_second": speed.tolist()}
    )
    drive = fastsim.SimDrive(fastsim.Vehicle.from_resource("2022_Renault_Zoe_ZE50_R135.yaml"), cycle)
    begun = time.process_time()
    drive.run()
    return time.process_time() - begun, float(np.sum(speed))


def progpy(result: RunResult, folder: Path) -> Measured:
    """ProgPy's battery by an equivalent circuit, with the power of the mission; the time simulated [s]."""
    from progpy.models import BatteryCircuit

    line = result.timeline
    power = sum(result.power_w(name) for name in result.batteries)
    battery = BatteryCircuit()
    amperes = 0.5 * power / power.max()

    def loading(t: float, x: object = None) -> object:
        row = max(int(np.searchsorted(line.start_s, t, side="right")) - 1, 0)
        return battery.InputContainer({"i": float(amperes[row])})

    begun = time.process_time()
    found = battery.simulate_to(result.duration_s, loading, dt=1.0, save_freq=1e9)
    return time.process_time() - begun, float(found.times[-1])


SUMO = """
import json, sys, time
import libsumo
words, blocks, pause, duration = json.loads(sys.argv[1])
libsumo.start(words)
route = [f"{part}{block}" for block in range(blocks) for part in "ab"]
libsumo.route.add("all", route)
libsumo.vehicletype.setAccel("DEFAULT_VEHTYPE", 0.5)
libsumo.vehicletype.setDecel("DEFAULT_VEHTYPE", 0.5)
libsumo.vehicle.add("robot", "all")
for block in range(blocks):
    libsumo.vehicle.setStop("robot", f"b{block}", libsumo.lane.getLength(f"b{block}_0") - 0.1, duration=pause)
begun = time.process_time()
libsumo.simulationStep(duration)
print(time.process_time() - begun, libsumo.vehicle.getDistance("robot"))
"""


def sumo(result: RunResult, folder: Path) -> Measured:
    """SUMO: the same lengths, limits and pauses for as long, a vehicle with a battery; the way [m].

    In a process of its own, since it brings another Arrow.
    """
    import sumolib  # the tools that come with it

    scale = float(folder.name)
    nodes, edges, at = ['<node id="n0" x="0" y="0"/>'], [], 0.0
    parts = [(part, block) for block in range(10) for part in (0, 1)]
    for number, (part, block) in enumerate(parts, 1):
        at += patrol.LENGTHS[part] * scale
        nodes.append(f'<node id="n{number}" x="{at}" y="0"/>')
        edges.append(
            f'<edge id="{"ab"[part]}{block}" from="n{number - 1}" to="n{number}" numLanes="1" '
            f'speed="{patrol.SPEEDS[part]}"/>'
        )
    (folder / "n.xml").write_text(f"<nodes>{''.join(nodes)}</nodes>")
    (folder / "e.xml").write_text(f"<edges>{''.join(edges)}</edges>")
    net = ["-n", "n.xml", "-e", "e.xml", "-o", "net.xml", "--no-internal-links", "--no-turnarounds"]
    subprocess.run([sumolib.checkBinary("netconvert"), *net], cwd=folder, check=True, capture_output=True)
    words = ["sumo", "-n", str(folder / "net.xml"), "--device.battery.probability", "1", "--no-step-log"]
    asked = json.dumps([words, 10, patrol.INSPECTION_S * scale, result.duration_s])
    path = f"import sys; sys.path[:] = {sys.path!r}"
    done = subprocess.run([sys.executable, "-c", path + SUMO, asked], capture_output=True, text=True, check=True)
    spent, way = map(float, done.stdout.split()[-2:])
    return spent, way
