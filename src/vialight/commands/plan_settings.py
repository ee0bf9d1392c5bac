"""How patterns are to be computed, checked when it is said."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vialight.core.errors import InputError
from vialight.planning.projections import CEILING, VOID_LIMIT, MethodName

_MOST_HELD = 9


@dataclass(frozen=True)
class PlanSettings:
    """How to compute patterns.

    Parameters
    ----------
    method
        See `vialight.planning.projections.methods`.
    passes
        Of the method; by default its own number.
    angles
        Projections in a turn, and patterns.
    voxel_mm
        By default the projector's pixel.
    coverage
        Voxels at the surface count by the share of them that is inside, instead of by their centres.
    void_limit
        Dose that a void may get, where the part gets 1.
    climbing
        Model the climb of rays above and below the optical axis; without, light stays in its slice, which is quicker
        and wrong by a few per cent at flat ends of a part.
    projector_blur_mm, diffusion_mm
        Standard deviations, in the resin, of what the forward model is to undo.
    held
        Angles that a pattern counts at while the vial turns under it; 1 takes it for a flash, which is quicker, and
        makes parts far from the axis less even.
    ceiling
        Of the method `object-space`: brightest light allowed, in that of the part's filtered backprojection.
    background, clip_level, bound_void
        Of the method `normalised`.
    rotate_deg, scale, fit, centre
        See `vialight.planning.target.place`.
    """

    method: MethodName = "object-space"
    passes: int | None = None
    angles: int = 360
    voxel_mm: float | None = None
    coverage: bool = False
    void_limit: float = VOID_LIMIT
    climbing: bool = True
    projector_blur_mm: float = 0.0
    diffusion_mm: float = 0.0
    held: int = 2
    ceiling: float = CEILING
    background: float = 0.5
    clip_level: float | None = None
    bound_void: bool = False
    rotate_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    scale: float | None = None
    fit: bool = False
    centre: bool = True

    def __post_init__(self) -> None:
        if self.angles < 4 or self.angles % 2:
            raise InputError("--angles", f"is {self.angles}", accepted="an even number, 4 or more")
        if self.passes is not None and self.passes < 1:
            raise InputError("--passes", f"is {self.passes}", accepted="1 or more")
        if not 1 <= self.held <= _MOST_HELD:
            raise InputError("--held", f"is {self.held}", accepted=f"1 to {_MOST_HELD}")
        if not 0 < self.void_limit < 1:
            raise InputError("--void-limit", f"is {self.void_limit}", accepted="more than 0 and less than 1")
        if not 0 < self.ceiling <= 1:
            raise InputError("--ceiling", f"is {self.ceiling}", accepted="more than 0, up to 1 for none")
        for name in ("projector_blur_mm", "diffusion_mm"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise InputError(
                    f"--{name.removesuffix('_mm').replace('_', '-')}", f"is {value}", accepted="0 or more mm"
                )

    def method_parameters(self) -> dict[str, float | bool | None]:
        """Return the parameters that only its method knows."""
        if self.method == "object-space":
            return {"ceiling": self.ceiling}
        if self.method != "normalised":
            return {}
        return {"background": self.background, "clip_level": self.clip_level, "bound_void": self.bound_void}


@dataclass(frozen=True)
class GivenProjections:
    """Projections computed elsewhere, to be resampled instead of computing any.

    Parameters
    ----------
    path, axes, angles, span_deg
        See `vialight.store.read_projections`.
    pixel_mm
        Width of a column and height of a row, in the part; by default the voxel.
    """

    path: Path
    axes: str
    angles: Path | None = None
    span_deg: float | None = None
    pixel_mm: float | None = None
