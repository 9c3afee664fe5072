"""A scan, from the motor's first step to the points: on a scanner that is all software.

Camera, axes and laser are three small protocols (`hardware.CameraDriver`, `.StageDriver`, `.LaserDriver`), and
whatever speaks them can be scanned with. Here they are simulated: the real driver of a BiStep2A04 talks to an emulated
controller over an emulated serial line, and a rendered world is photographed. With a `scanner.toml` that describes
yours, `open_scanner(read_scanner(Path("scanner.toml")))` of `hardware.devices` gives the devices in their place.

Every frame is on the disk, whole, before the stage moves on: a scan that ends early is continued later. This one is
ended after two frames, on purpose.
"""

import tempfile
from pathlib import Path

import photographs

import jaxscan
from hardware import Frame
from hardware.errors import StoppedError
from hardware.scan import Control, Devices, take
from hardware.scan_plan import Plan, ScanFolder
from hardware.simulated.camera import SimulatedCamera, SimulatedWorld
from hardware.simulated.laser import SimulatedLaser
from hardware.simulated.stage import SimulatedStage
from hardware.stages import Travel
from jaxscan.simulation import rig_2003, shapes

out = Path(tempfile.mkdtemp(prefix="scan-", dir=photographs.folder()))
plan = Plan(axes={"stage": tuple(range(0, 48_001, 12_000))}, settle_s=0.0, name="cup")
folder, control = ScanFolder.create(out / "cup", plan), Control()


def taken(path: Path, frame: Frame) -> None:
    """Say so, and end the scan after the second frame."""
    print(f"{path.name} at {frame.place}")
    if len(folder.done.frames) == 2:
        control.abort()


world = SimulatedWorld(0, shapes.cup(rig_2003.OBJECT_Y))
stage, laser = SimulatedStage(Travel(last=50_000)), SimulatedLaser()
devices = Devices(SimulatedCamera(world, {"stage": stage}, laser), {"stage": stage}, laser)
try:
    take(folder, devices, control, taken)
except StoppedError as stopped:
    print(f"  {stopped}")
left = tuple(place["stage"] for place in ScanFolder.resume(out / "cup").left)
print(f"laser off: {not laser.lit}; still to be taken: {left}")

# Later, or in another program: a new look at the folder, the same devices.
folder = ScanFolder.resume(out / "cup")
take(folder, devices, taken=lambda path, frame: print(f"{path.name} at {frame.place}"))
stage.close()

# The true rig of this world; a real scanner has what `jaxscan.calibrate` gives.
for image in jaxscan.Scanner(world.rig).scan(jaxscan.read_scan(out / "cup")):
    for step, valid in zip(image.steps, image.valid, strict=True):
        print(f"step {step:6}: {valid.sum()} points")
