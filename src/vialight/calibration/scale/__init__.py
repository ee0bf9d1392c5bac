"""Millimetres a pixel, from the edges of the vial (`edge_scale`) or from a flat target (`flat_target`)."""
