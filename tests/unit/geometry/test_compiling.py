"""Compilation by Numba, if it is installed."""

from __future__ import annotations

import os
import signal
from typing import Any

import pytest

from gibson_sim.geometry.compiling import CAN_COMPILE, compiled
from gibson_sim.interrupts import Interruptible

if not CAN_COMPILE:
    pytest.skip("SKIPPED: Numba is not installed, or told not to compile", allow_module_level=True)

from numba.core import event


def test_ctrl_c_in_the_middle_of_a_compilation_interrupts_after_it() -> None:
    class InAPass(event.Listener):
        """Sends SIGINT in the first pass of the compiler."""

        pressed = False

        def on_start(self, event: Any) -> None:
            if not self.pressed:
                self.pressed = True
                os.kill(os.getpid(), signal.SIGINT)

        def on_end(self, event: Any) -> None:
            pass

    space: dict[str, Any] = {}
    exec("def double(x):\n    return 2.0 * x", space)  # without a file there is no cache
    double: Any = compiled(space["double"])
    listener = InAPass()
    before = signal.getsignal(signal.SIGINT)
    with (
        event.install_listener("numba:run_pass", listener),
        Interruptible(),
        pytest.raises(KeyboardInterrupt),
    ):
        double(4.0)
    assert listener.pressed and signal.getsignal(signal.SIGINT) == before
    assert len(double.signatures) == 1, "it was compiled to the end"
    assert double(4.0) == 8.0
