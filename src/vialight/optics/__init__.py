"""Where a ray of the camera or of the projector runs.

Start with `refraction`: it bends one ray at the wall of the vial, in closed form.

- `viewing`: the pixel, and the direction, in which a point of the resin is seen
- `run_out`: where things are seen when the vial's axis is not the stage's, or leans
"""
