"""A terminal for tests: a command runs in a pseudo-terminal, and its screen is read as text."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import select
import struct
import subprocess
import termios
import threading
import time

import pyte


class Terminal:
    """A command in a terminal that, as most do, wraps long lines anew when it is made narrower."""

    def __init__(self, words, folder, size=(100, 30)):
        self._master, slave = pty.openpty()
        self._lock = threading.Lock()
        self._gone = False
        self._start_screen(*size)
        self.process = subprocess.Popen(
            words, stdin=slave, stdout=slave, stderr=slave, cwd=folder, start_new_session=True,
            env={**os.environ, "TERM": "xterm-256color"},
        )  # fmt: skip
        os.close(slave)
        self._watchdog = threading.Timer(300, self.process.kill)
        self._watchdog.start()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _start_screen(self, columns, rows):
        size = struct.pack("HHHH", rows, columns, 0, 0)
        fcntl.ioctl(self._master, termios.TIOCSWINSZ, size)
        self._screen = pyte.Screen(columns, rows)
        self._stream = pyte.ByteStream(self._screen)

    def _read(self):
        while not self._gone:
            if not select.select([self._master], [], [], 0.05)[0]:
                continue
            try:
                data = os.read(self._master, 1 << 16)
            except OSError:  # the command has ended
                return
            with self._lock:
                self._stream.feed(data)

    def resize(self, columns, rows):
        """Give the terminal another size, and show what it showed as terminals do."""
        with self._lock:
            lines = [line.rstrip() for line in self._screen.display[: self._screen.cursor.y + 1]]
            self._start_screen(columns, rows)
            self._stream.feed("\r\n".join(lines).encode())

    def lines(self):
        """Return the lines on the screen."""
        with self._lock:
            return [line.rstrip() for line in self._screen.display]

    def _colour_of(self, text):
        """Return the colour of a text on the screen; None if it is not there."""
        for row, line in enumerate(self._screen.display):
            if text in line:
                return self._screen.buffer[row][line.index(text)].fg
        return None

    def coloured(self):
        """Return each line as letters with their colour and whether they are bold."""
        with self._lock:
            columns = range(self._screen.columns)
            rows = [self._screen.buffer[row] for row in range(self._screen.lines)]
            return [[(row[x].data, row[x].fg, row[x].bold) for x in columns] for row in rows]

    def wait_for(self, *texts, without="\0", **colours):
        """Wait until the screen shows all texts at once, and of each colour that text.

        Parameters
        ----------
        without : str
            A text that it does not show.
        """
        end = time.monotonic() + 120
        while True:
            with self._lock:
                shown = "\n".join(self._screen.display)
                if (
                    all(re.search(text, shown) for text in texts)
                    and without not in shown
                    and all(self._colour_of(text) == colour for colour, text in colours.items())
                ):
                    return
            assert self.process.poll() is None, shown
            assert time.monotonic() < end, shown
            time.sleep(0.02)

    def hang_up(self):
        """Close the terminal, as somebody does who closes its window."""
        self._gone = True
        self._reader.join()
        os.close(self._master)

    def end(self, number=None, seconds=60):
        """Send a signal, or wait for the end; return the exit code and what is on the screen."""
        if number is not None:
            self.process.send_signal(number)
        code = self.process.wait(seconds)
        self._watchdog.cancel()
        self._reader.join(timeout=1)
        return code, "\n".join(self.lines())
