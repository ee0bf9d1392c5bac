"""Frames in, snapshots out: the print is measured while it forms.

Start with `watcher`: it is the live measurement as one thing.

- `following`: the process that renews the volume with every frame
- `analysing`, `analysis`: the process that measures the volume about once a second
- `sharing`: the volume, in memory that both processes see
- `lit_time`: for how long light has been on
"""
