"""What each command does, files in and files out; the command line only parses.

Every function returns what it wrote as JSON, and writes all of its products or none.
"""

from vialight.commands.exporting import export_plan
from vialight.commands.measuring import measure_surface, reconstruct_recording
from vialight.commands.plan_settings import GivenProjections, PlanSettings
from vialight.commands.planning import plan_part, score_plan
from vialight.commands.serving import serve_runs

__all__ = [
    "GivenProjections",
    "PlanSettings",
    "export_plan",
    "measure_surface",
    "plan_part",
    "reconstruct_recording",
    "score_plan",
    "serve_runs",
]
