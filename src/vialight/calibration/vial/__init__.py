"""Outer radius, index and distance: what bends the rays, from opposite views."""
