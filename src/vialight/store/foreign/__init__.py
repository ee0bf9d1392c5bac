"""Files of other programs: projections, height maps of profilometers, patterns for other printers."""
