"""When to stop a print: what is believed before it, what is seen while it runs, and the forecast from both.

Start with `stop_model`: it is what a rehearsal leaves for the print.

- `rehearsal`: how a resin would cure under a plan's patterns
- `rehearsed_model`, `kept_rehearsals`: a stop model from rehearsals of several resins; each is computed once
- `history`: what has been seen to cure, and when
- `prediction`: the moment at which to stop
- `forecast`: both of these, fed with the live volume
- `lateness`: where a print fell behind its rehearsal
- `looking_back`: a recording seen again, as it was seen live

All times here are *lit* times: seconds for which the projector has shown patterns.  A lit time stands still while the
light is off, as it may be after a fault.  Curing stands still then too, apart from what the dark cure adds.
"""
