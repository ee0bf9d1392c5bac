"""From a part to the light patterns that print it, and what patterns of any origin would print.

Start with `projections`: its `optimise` computes the light.

- `target`: a part is checked, placed in the vial and cut into voxels
- `strips`: the matched pair of projector and backprojector for light
- `scoring`: how good a dose is
- `shapes`: parts that are made by formula
"""
