"""Signals that end a process: they end a run, and its rig is left safe before it ends."""

import atexit
import os
import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress

# a closed terminal, but on Windows; kill, a service's stop; Ctrl-C
ENDS = (getattr(signal, "SIGHUP", signal.SIGTERM), signal.SIGTERM, signal.SIGINT)
USUAL = (signal.SIG_DFL, signal.default_int_handler)
SAFE_TIME = 10.0  # s, that safe() of a rig may take before a signal ends it
RUNS = b"\nsafe() of the rig runs, wait: this signal counts when the rig is safe\n"


class Interrupts:
    """Signals that end a process, noted: each raises at once, and the first one in `check`, too.

    A driver may swallow the exception, or Python itself, where it comes in a destructor. So a run
    calls `check` before each command. When it ends it sets `until`, by a statement that calls
    nothing and so cannot be interrupted, and then calls `leave`.
    """

    def __init__(self, make_safe: Callable[[], None], safe_time: float):
        self.make_safe, self.safe_time = make_safe, safe_time
        self.number, self.handlers, self.until = None, {}, None
        self.process, self.is_safe = os.getpid(), threading.Event()

    def watch(self) -> None:
        """Note Ctrl-C, even if asyncio handles it; others, unless somebody handles them."""
        atexit.register(self.end_thread)
        with suppress(ValueError):  # of a thread that is not the main one
            for number in ENDS:
                handler = signal.getsignal(number)
                if handler in USUAL or (number == signal.SIGINT and callable(handler)):
                    self.handlers[number] = handler
                    signal.signal(number, self.note)

    def note(self, number, frame) -> None:
        """Handle a signal."""
        self.number = self.number or number
        if self.until is None:
            self.check()
        elif time.monotonic() > self.until:
            raise KeyboardInterrupt  # to which `make_safe` adds its note
        else:
            with suppress(OSError):  # of a closed terminal; `print` is not reentrant
                os.write(2, RUNS)

    def check(self) -> None:
        """Raise what the first signal asks for, if one came."""
        if self.number == signal.SIGINT:
            raise KeyboardInterrupt
        if self.number:
            raise SystemExit(128 + self.number)

    def leave(self) -> None:
        """Leave the rig safe, unless this is a forked child: the rig is its parent's."""
        self.until = time.monotonic() + self.safe_time
        try:
            if os.getpid() == self.process:
                self.make_safe()
        finally:
            atexit.unregister(self.end_thread)
            self.is_safe.set()
            for number, handler in self.handlers.items():  # Ctrl-C, which may raise here, is last
                signal.signal(number, handler)
        self.check()

    def end_thread(self) -> None:
        """End a run in another thread at its next command, when the process ends."""
        if os.getpid() == self.process:
            self.number = signal.SIGTERM
            self.is_safe.wait()
