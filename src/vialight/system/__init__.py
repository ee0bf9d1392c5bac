"""What vialight asks the operating system: processes, waits, files that anyone may have made, and memory.

- `archives`: zip archives of which the unpacked size is known first
- `files`: plain files only, of a sane size, and none outside a run's folder
- `memory`: whether there is enough
- `processes`: a process told apart from a later one of the same number; whether it runs, is stopped, or is gone
- `waiting`: waits that have an end, and end at once where something is wrong
"""

from vialight.system.archives import open_archive
from vialight.system.files import check_plain, file_in, open_plain, read_plain
from vialight.system.memory import need_memory
from vialight.system.processes import ProcessIdentity, ProcessState, identity_of, is_same_process, state_of
from vialight.system.waiting import wait_for

__all__ = [
    "ProcessIdentity",
    "ProcessState",
    "check_plain",
    "file_in",
    "identity_of",
    "is_same_process",
    "need_memory",
    "open_archive",
    "open_plain",
    "read_plain",
    "state_of",
    "wait_for",
]
