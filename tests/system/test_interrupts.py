"""Ctrl-C and the wish to end are heard at once, whatever holds up the main thread."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time

import pytest

from vialight.system import StopAsked, deaf_to_interrupts

HELD_UP = """
import hashlib, os, signal
from vialight.system import StopAsked

def tell():
    os.write(1, b"heard\\n")

signal.signal(signal.SIGTERM, lambda *_: None)  # as every command has one
asked = StopAsked(tell)
asked.__enter__()
os.write(1, b"held up\\n")
hashlib.pbkdf2_hmac("sha256", b"x", b"y", 12_000_000)  # seconds without a step of Python
os.write(1, b"goes on\\n")
"""


@pytest.mark.alone
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_is_heard_while_the_main_thread_is_in_a_long_call(number: signal.Signals) -> None:
    process = subprocess.Popen([sys.executable, "-c", HELD_UP], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "held up\n"
    time.sleep(0.2)
    sent = time.monotonic()
    process.send_signal(number)
    told = process.stdout.readline()
    took_s = time.monotonic() - sent
    process.kill()
    process.communicate()
    assert told == "heard\n"
    assert took_s < 0.25


def test_second_interrupt_interrupts_as_ever() -> None:
    with StopAsked() as asked:
        signal.raise_signal(signal.SIGINT)
        assert asked
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_what_was_there_before_is_there_again_and_nothing_is_told_without_a_signal() -> None:
    told: list[int] = []
    with StopAsked(lambda: told.append(1)) as asked:
        time.sleep(0.05)
    assert not asked
    assert told == []
    assert signal.set_wakeup_fd(-1) == -1


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="the system cannot make a thread deaf")
def test_process_that_is_still_starting_lives_through_an_interrupt() -> None:
    process = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(0.1,), daemon=True)
    with deaf_to_interrupts():
        process.start()
    assert process.pid is not None
    os.kill(process.pid, signal.SIGINT)  # long before its own first line
    process.join(60)
    assert process.exitcode == 0
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, set())


def test_ctrl_z_stops_no_process_that_has_left_it_to_the_print() -> None:
    """Projector and guardian would stand still together, with the light on."""
    code = "from vialight.system import leave_interrupts_to_the_print as leave; leave(); print('left', flush=True)"
    process = subprocess.Popen(
        [sys.executable, "-c", f"{code}; input()"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "left\n"
    process.send_signal(signal.SIGTSTP)
    process.send_signal(signal.SIGINT)
    process.communicate("on\n", timeout=10)
    assert process.returncode == 0
