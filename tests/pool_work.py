"""Work for processes of a pool, which import this module and nothing more of the tests."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from hatn_sim.errors import InputError
from hatn_sim.evaluation.pool import Stopped, Teller


def double(item: int, teller: Teller) -> int:
    teller.tell(item)
    if item == 13:
        raise InputError("thirteen")
    return 2 * item


def die(item: int, teller: Teller) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return item


def wait_for_others(item: int, teller: Teller) -> int:
    if item == 0:
        Path("begun").touch()
    while not Path("begun").exists():
        time.sleep(0.01)
    if item == 1:
        raise InputError("one")
    try:
        while True:
            teller.tell(1)
            time.sleep(0.01)
    except Stopped:
        Path("stopped").touch()
        raise
