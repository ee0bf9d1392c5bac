"""How far a print is off from what was meant.

Start with `comparison`: its `compare` makes all measurements.  The other modules can be used alone:

- `surface`, `contours`: the surface at which the density crosses the threshold
- `distance`: signed distances and their area-weighted statistics
- `registration`, `symmetry`, `rigid`: the print is laid on its reference, as far as the part's symmetry lets it
- `overlap`: intersection over union
- `cylinders`, `round_faces`: fitted diameters
- `kinetics`: the print over time: its dose, when it gelled, where it began to fail
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
