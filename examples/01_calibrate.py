"""From photographs of a checkerboard to a calibrated scanner, and how far each of its numbers can be trusted.

A session is a folder of photographs: the board in many poses with the laser on, and the board riding on the stage.
`observe` finds corners and stripes in them, with OpenCV and NumPy; `calibrate` puts all of them into one least-squares
problem in JAX, in which lens, light plane, stage and the pose of every board move together. So the result has *one*
covariance, and that of anything computed from the rig follows from it (example 3). `calibrate_by_evidence` does that,
and adds terms, of a lens or of a board that bends, where the photographs ask for them.
"""

import jax
import numpy as np
import photographs

import jaxscan

session = jaxscan.read_session(photographs.world() / "session")
observations = jaxscan.observe(session)
camera = session.camera  # what session.toml says of it: which lens terms, and whether the principal point is free
calibration = jaxscan.calibrate_by_evidence(
    observations, jaxscan.Model(camera.lens), principal_point=camera.principal_point, hold=camera.hold
)

# Each residual is divided by its own σ, and both σ come out of the fit: nobody has to tell them.
print(f"{len(calibration.fits)} boards, {len(calibration.moved_fits)} photographs of the stage")
print(f"σ of a corner {calibration.corner_sigma_px:.3f} px, of a stripe point {calibration.stripe_sigma_px:.3f} px")
for words in calibration.left_out:
    print(f"left out: {words}")

# A rig is a pytree. Its leaves have names, by which the covariance knows them.
rig, sigma = calibration.rig, calibration.covariance.sigma
plane, stage = rig.light(), rig.axis("stage")  # both raise where a session has no photographs of them
assert isinstance(plane, jaxscan.LightPlane)  # other kinds of light have other numbers
assert isinstance(stage, jaxscan.Linear)
shown = {
    "camera.focal.0": (rig.camera.focal[0], "px"),
    "camera.principal.0": (rig.camera.principal[0], "px"),
    "camera.radial.0": (jax.tree.leaves(rig.camera.lens)[0], ""),
    "lights.0.plane.1": (plane.plane[1], "1/mm"),
    "lights.0.plane.2": (plane.plane[2], "1/mm"),
    "motion.stage.per_step.1": (stage.per_step[1], "mm"),
}
for name, (value, unit) in shown.items():
    print(f"{name:20} {value:12.6g} ± {sigma(name):.2g} {unit}")
per_step = np.linalg.norm(stage.per_step)
print(f"the stage moves its load by {1000 * per_step:.5f} mm in 1000 steps, {stage.way()}")

# What can be told in a moment of how far to trust it; `--report` looks longer.
judged = jaxscan.verdict(calibration)
print(judged.statement)
for warning in judged.warnings:
    print(f"{warning.level}: {warning.statement}")

# The file has the covariance too. `jaxscan calibrate session -o rig.json --report report` writes the same rig.
out = photographs.folder() / "rig.json"
jaxscan.write_rig(out, calibration.rig_file())
print(f"written: {out}")
