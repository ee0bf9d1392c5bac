"""What the processes of one print tell each other: newest states by mailbox, orders by a control channel."""

from vialight.links.control import ControlServer, send_order
from vialight.links.interrupts import leave_interrupts_to_the_print
from vialight.links.live import LiveLink, find_live_print
from vialight.links.mailboxes import Mailbox, shared_folder
from vialight.links.messages import CameraImage, PrintStatus, Snapshot, StopForecast, Sums, SurfaceSnapshot

__all__ = [
    "CameraImage",
    "ControlServer",
    "LiveLink",
    "Mailbox",
    "PrintStatus",
    "Snapshot",
    "StopForecast",
    "Sums",
    "SurfaceSnapshot",
    "find_live_print",
    "leave_interrupts_to_the_print",
    "send_order",
    "shared_folder",
]
