"""Programs that call kernels of modules in a folder, and keep their compiled code there."""

from __future__ import annotations

import os
import subprocess
import sys

KERNEL = "from edge_vpr.compiling import kernel\n\n@kernel\n"
ONE_KERNEL = f"{KERNEL}def plus_one(x):\n    return x + 1\n"

#: runs each program that it reads in a child of its own, which need not import Numba again
_SERVER = """
import importlib, os, sys, traceback
from numba import njit
import edge_vpr.compiling

njit(lambda x: x)(1)  # what Numba prepares once
for line in sys.stdin:
    if os.fork() == 0:
        importlib.invalidate_caches()
        try:
            exec(eval(line), {})
        except BaseException:
            traceback.print_exc()
            os._exit(1)
        sys.stdout.flush()
        os._exit(0)
    code = os.waitstatus_to_exitcode(os.wait()[1])
    print("ended", code, flush=True)
"""


class Runner:
    """Runs programs that import modules of a folder, and keeps their kernels there."""

    def __init__(self, folder, **more):
        paths = os.pathsep.join([str(folder), *filter(None, sys.path)])
        kept = {"NUMBA_CACHE_DIR": str(folder), "PYTHONPATH": paths}
        self._server = subprocess.Popen(
            # no bytecode: it would be taken for that of a source changed within the same second
            [sys.executable, "-B", "-c", _SERVER],
            env={**os.environ, **kept, **more},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def __enter__(self):
        return self

    def __exit__(self, *unused):
        self._server.communicate()

    def __call__(self, program):
        """Return what the program prints; it starts with no module of the folder imported."""
        self._server.stdin.write(f"{program!r}\n")
        self._server.stdin.flush()
        said = []
        for line in self._server.stdout:
            if line.startswith("ended "):
                assert line == "ended 0\n"
                return "".join(said).strip()
            said.append(line)
        raise AssertionError("the server has ended")
