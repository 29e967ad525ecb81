"""Program: run commands, and print what each compiles outside of its warm-up.

It has to run in a process of its own, in which nothing else has compiled a kernel. Each argument
is the words of one command.
"""

from __future__ import annotations

import shlex
import sys

from edge_vpr_tools.cli import main
from numba.core import event

import edge_vpr.warm_up
from edge_vpr.warm_up import warm_up


class Listener(event.Listener):
    """Notes what is compiled during the warm-up, and outside of it."""

    def __init__(self):
        self.within, self.shown, self.late = False, [], []

    def on_start(self, event):
        function = event.data["dispatcher"].py_func
        if not self.within:
            self.late.append(f"{function.__module__}.{function.__name__} {event.data['args']}")

    def on_end(self, event):
        pass

    def warm_up(self, steps, show):
        def noted(text):
            self.shown.append(text)
            show(text)

        self.within = True
        warm_up(steps, noted)
        self.within = False


if __name__ == "__main__":
    listener = Listener()
    edge_vpr.warm_up.warm_up = listener.warm_up  # which commands import when they run
    with event.install_listener("numba:compile", listener):
        for words in sys.argv[1:]:
            assert main(shlex.split(words)) == 0, words
            assert not listener.late, (words, listener.late)
            assert any("(1 of " in text for text in listener.shown), words
    assert sum(text.startswith("compiling kernels: ") for text in listener.shown) > 20
