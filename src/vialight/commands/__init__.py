"""What each command does, files in and files out; the command line only parses.

Every function returns what it wrote as JSON, and writes all of its products or none.
"""

from vialight.commands.export import export_plan
from vialight.commands.measure import measure_surface
from vialight.commands.plan import plan_part, score_plan
from vialight.commands.plan_settings import GivenProjections, PlanSettings
from vialight.commands.reconstruct import reconstruct_recording
from vialight.commands.serve import serve_runs

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
