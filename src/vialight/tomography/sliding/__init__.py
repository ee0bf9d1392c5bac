"""The volume of the latest turn, renewed with every frame.

Start with `window`.  `turn` keeps the frames of the latest turn, and `schedule` decides when an angle enters the
volume.
"""
