"""Files of other programs: meshes, projections, height maps of profilometers, patterns for other printers."""
