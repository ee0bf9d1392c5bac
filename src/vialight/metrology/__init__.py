"""Stage: how far a print is off from what was meant.

`compare` is the one verb; the modules below it can be used alone:

- `distance`: signed distances and their area-weighted statistics
- `registration`, `symmetry`, `rigid`: laying the print on its reference, and what a symmetric part leaves open
- `overlap`: intersection over union, and sum projections
- `cylinders`, `round_faces`: fitted diameters
"""

from vialight.metrology.comparison import Agreement, Comparison, Tolerance, compare
from vialight.metrology.cylinders import Cylinder, measure_cylinders
from vialight.metrology.distance import Deviation, sample_surface, signed_distance, unsigned_distance
from vialight.metrology.overlap import ColumnGrid, column_grid, crossings, intersection_over_union, thickness
from vialight.metrology.registration import Registration, register

__all__ = [
    "Agreement",
    "ColumnGrid",
    "Comparison",
    "Cylinder",
    "Deviation",
    "Registration",
    "Tolerance",
    "column_grid",
    "compare",
    "crossings",
    "intersection_over_union",
    "measure_cylinders",
    "register",
    "sample_surface",
    "signed_distance",
    "thickness",
    "unsigned_distance",
]
