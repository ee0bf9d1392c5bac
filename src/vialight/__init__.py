"""Tomographic volumetric printing, measured while it cures."""

from importlib.metadata import version

__version__ = version("vialight")
