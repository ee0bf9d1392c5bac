"""A printer that is not there: camera, stage and projector in front of the twin, each in the process it would have.

The processes are those of a real printer, so that each can be killed: the projector's (`vialight.devices.projecting`),
the display's, which stands for graphics driver and curtain, and the world's, in which resin cures and light scatters.
"""

from vialight.devices.simulated.mishaps import Mishaps
from vialight.devices.simulated.printer import SimulatedPrinter
from vialight.devices.simulated.world import WorldSettings

__all__ = ["Mishaps", "SimulatedPrinter", "WorldSettings"]
