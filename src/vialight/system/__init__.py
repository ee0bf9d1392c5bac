"""What vialight asks the operating system: who a process is and how it does; and the one way to wait for something.

- `processes`: a process told apart from a later one of the same number; whether it runs, is stopped, or is gone
- `waiting`: waits that have an end, and end at once where something is wrong
"""

from vialight.system.processes import ProcessIdentity, ProcessState, identity_of, is_same_process, state_of
from vialight.system.waiting import wait_for

__all__ = [
    "ProcessIdentity",
    "ProcessState",
    "identity_of",
    "is_same_process",
    "state_of",
    "wait_for",
]
