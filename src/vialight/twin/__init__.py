"""Stage: a physical model of projector, resin and camera that stands in for the hardware.

It traces rays through glass and resin and knows nothing of the closed forms that it is there to test:
``docs/twin.md`` has every equation, constant and unit.
"""
