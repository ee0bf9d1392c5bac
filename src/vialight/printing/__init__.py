"""A plan played through devices, recorded, watched and brought to its end: start reading at `session`.

- `track`: where the stage is at any moment
- `light`: its one owner, who gives leave to the projector only while everything is well
- `recorder`: every frame on disk before it counts
- `preflight`: what is checked before the first light
- `doubts`: what makes the calibration doubtful, which is told
- `settings`, `watching`: how to print, and what is asked of who measures it
- `session`: the order of it all
- `order_channel`, `live_link`: orders to a running print, and how other processes find it
- `live`: the print measured while it forms
"""
