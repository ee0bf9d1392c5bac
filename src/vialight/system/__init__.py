"""What vialight asks the operating system: processes, waits, files that anyone may have made, and memory.

- `archives`: zip archives of which the unpacked size is known first
- `files`: plain files only, of a sane size, and none outside a run's folder
- `memory`: whether there is enough
- `processes`: a process told apart from a later one of the same number; whether it runs, is stopped, or is gone; and
  children that import nothing from the current folder
- `shared_files`: private folders in memory, and files in them that several processes map
- `mailboxes`: the newest of something, shared between processes that never wait for each other
- `interrupts`: Ctrl-C and the wish to end, heard at once whatever the main thread does
- `lines`: lines for a slow place, for which nobody waits
- `waiting`: waits that have an end, and end at once where something is wrong
"""

from vialight.system.archives import open_archive
from vialight.system.files import check_plain, file_in, open_plain, read_plain
from vialight.system.interrupts import StopAsked, deaf_to_interrupts, leave_interrupts_to_the_print
from vialight.system.lines import LineWriter
from vialight.system.memory import need_memory
from vialight.system.processes import (
    ProcessIdentity,
    ProcessState,
    identity_of,
    is_same_process,
    no_code_from_here,
    state_of,
)
from vialight.system.shared_files import (
    is_shared_folder,
    make_shared_file,
    map_shared_file,
    reserve,
    scratch_folder,
    shared_folder,
    words_of,
)
from vialight.system.waiting import wait_for

__all__ = [
    "LineWriter",
    "ProcessIdentity",
    "ProcessState",
    "StopAsked",
    "check_plain",
    "deaf_to_interrupts",
    "file_in",
    "identity_of",
    "is_same_process",
    "is_shared_folder",
    "leave_interrupts_to_the_print",
    "make_shared_file",
    "map_shared_file",
    "need_memory",
    "no_code_from_here",
    "open_archive",
    "open_plain",
    "read_plain",
    "reserve",
    "scratch_folder",
    "shared_folder",
    "state_of",
    "wait_for",
    "words_of",
]
