"""Stage: how far a print is off from what was meant.

`compare` is the one verb; the modules below it can be used alone:

- `distance`: signed distances and their area-weighted statistics
- `registration`, `symmetry`, `rigid`: laying the print on its reference, and what a symmetric part leaves open
- `overlap`: intersection over union
- `cylinders`, `round_faces`: fitted diameters
"""

from vialight.metrology.comparison import Agreement, Comparison, Tolerance, compare
from vialight.metrology.cylinders import Cylinder, measure_cylinders
from vialight.metrology.distance import Deviation, sample_surface, signed_distance, unsigned_distance
from vialight.metrology.overlap import intersection_over_union
from vialight.metrology.registration import Registration, register

__all__ = [
    "Agreement",
    "Comparison",
    "Cylinder",
    "Deviation",
    "Registration",
    "Tolerance",
    "compare",
    "intersection_over_union",
    "measure_cylinders",
    "register",
    "sample_surface",
    "signed_distance",
    "unsigned_distance",
]
