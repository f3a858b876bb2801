"""Handle signals that end a process: the run stops, and the rig is left safe first."""

import atexit
import math
import os
import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress

# a closed terminal, except on Windows; kill, or the stop of a service; Ctrl-C
ENDING_SIGNALS = (getattr(signal, "SIGHUP", signal.SIGTERM), signal.SIGTERM, signal.SIGINT)
USUAL_HANDLERS = (signal.SIG_DFL, signal.default_int_handler)
SAFE_TIME = 10.0  # s, the longest time of safe() of a rig before a signal ends it
WAIT_NOTICE = b"\nsignal noted, wait: the rig is being left safe\n"


class Interrupts:
    """Record signals that end a process; after a signal, only `safe` of the driver is called.

    A signal during a call of the driver raises an exception at once, because the driver may hang.
    Elsewhere a signal does not raise an exception: the exception could be swallowed, as in a
    destructor, or leave a lock behind.
    """

    def __init__(self, make_safe: Callable, safe_time: float):
        self.make_safe, self.safe_time = make_safe, safe_time
        self.number, self.handlers, self.until = None, {}, math.inf  # when signals begin to raise
        self.process, self.is_safe = os.getpid(), threading.Event()

    def watch(self) -> None:
        """Begin to note signals: Ctrl-C always, and others unless the program handles them.

        Ctrl-C is noted even if asyncio handles it. A handler that C code has installed, which
        `getsignal` gives as None, is left alone.
        """
        atexit.register(self.end_thread)
        # only the main thread of the main interpreter can set handlers
        with suppress(ValueError):
            for number in ENDING_SIGNALS:
                handler = signal.getsignal(number)
                if handler in USUAL_HANDLERS or (number == signal.SIGINT and callable(handler)):
                    signal.signal(number, self.note)
                    self.handlers[number] = handler  # it is replaced now, and must be restored

    def note(self, number, frame) -> None:
        """Note a signal; raise KeyboardInterrupt if exceptions are allowed at this time."""
        self.number = self.number or number
        if time.monotonic() > self.until:
            raise KeyboardInterrupt
        with suppress(OSError):  # of a closed terminal; `print` is not reentrant
            os.write(2, WAIT_NOTICE)

    def call(self, method: Callable, *arguments):
        """Call a method of the driver, and return its result.

        During the call, a signal raises an exception.
        """
        try:
            self.until = -math.inf
            if self.number:
                raise KeyboardInterrupt
            return method(*arguments)
        finally:
            self.until = math.inf

    def leave(self) -> None:
        """Leave the rig safe, unless this process is a forked child, whose parent has the rig."""
        self.until = time.monotonic() + self.safe_time
        try:
            if os.getpid() == self.process:
                self.make_safe()
        finally:
            atexit.unregister(self.end_thread)
            self.is_safe.set()
            for number, handler in self.handlers.items():  # Ctrl-C, which may raise here, is last
                signal.signal(number, handler)
        if number := self.number:
            raise KeyboardInterrupt if number == signal.SIGINT else SystemExit(128 + number)

    def end_thread(self) -> None:
        """End a run in another thread at its next command, when the process ends."""
        if os.getpid() == self.process:
            self.number = signal.SIGTERM
            self.is_safe.wait()
