"""What a rig says of its instruments, found from recordings.

Each folder is one calibration and holds three things: its estimator (arrays in, values with standard uncertainties
out), its command (files in, a `Calibrated` out) and its figures.  The folders are `axis`, `vial`, `scale`, `threshold`,
`resin`, `projector` and `latency`; `check` says whether all of these still hold.

The modules beside the folders serve several of them.  Start with `findings`, which every calibration returns.
"""
