"""What a calibration finds: estimators, arrays in, values with their standard uncertainties out."""

from vialight.calibrate.findings import Finding, Findings
from vialight.calibrate.working_curve import WorkingCurve, fit_working_curve

__all__ = ["Finding", "Findings", "WorkingCurve", "fit_working_curve"]
