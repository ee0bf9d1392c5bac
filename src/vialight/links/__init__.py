"""What the processes of one print tell each other: newest states by mailbox, the light's panel, orders to the print."""

from vialight.links.control import ControlServer, send_order, stop_print
from vialight.links.live import LiveLink, UnknownStateError, find_live_print
from vialight.links.mailboxes import Mailbox
from vialight.links.messages import CameraImage, PrintStatus, Snapshot, StopForecast, Sums, SurfaceSnapshot
from vialight.links.panel import LightPanel

__all__ = [
    "CameraImage",
    "ControlServer",
    "LightPanel",
    "LiveLink",
    "Mailbox",
    "PrintStatus",
    "Snapshot",
    "StopForecast",
    "Sums",
    "SurfaceSnapshot",
    "UnknownStateError",
    "find_live_print",
    "send_order",
    "stop_print",
]
