"""The gelation threshold I_p, from standard cylinders or from a print whose surface is known.

`by_rim` finds it at the rim of a cylinder, `by_surface` on a known surface.  `standards` reads the recordings of both.
"""
