"""What all tests share: real data where it lies, and patience with compilers."""

from __future__ import annotations

import errno
import os
import pty
import resource
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import pytest
import serial
from hypothesis import HealthCheck, settings

# A kernel's first call compiles it: no test of a property is about time.
settings.register_profile(
    "edge-vpr",
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
settings.load_profile("edge-vpr")


def pytest_configure(config: pytest.Config) -> None:
    """Let all workers and runs share what Zig has compiled, which it finds by its content."""
    if config.pluginmanager.hasplugin("cacheprovider"):
        cache = config.cache.mkdir("zig")  # type: ignore[union-attr]
        os.environ.setdefault("ZIG_LOCAL_CACHE_DIR", str(cache))


#: modules whose tests compile no kernels in their process
WITHOUT_KERNELS = (
    *("test_board", "test_core_area", "test_evpr_firmware", "test_firmware", "test_fixedpoint"),
    *("test_fuzz_images", "test_golden", "test_hardware", "test_mutants", "test_packages"),
    *("test_rooms", "test_security", "test_site", "test_vectors_on_a_board"),
)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Let the second of two workers begin with tests that compile nothing.

    Each worker begins with its share of the tests, in their order. In the order of their names,
    both would compile the same kernels at the same time. So, the second finds most of them.
    """
    if hasattr(config, "workerinput"):
        plain = [item for item in items if item.path.stem in WITHOUT_KERNELS]
        others = [item for item in items if item.path.stem not in WITHOUT_KERNELS]
        half = len(items) // 2
        items[:] = others[:half] + plain + others[half:]


SHARED_DATA = Path(__file__).parents[1].parent / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real recordings, which are not part of the project."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"real data is not at {SHARED_DATA}")
    return SHARED_DATA


@pytest.fixture(scope="session")
def any_baud() -> None:
    """Skip where serial ports take the usual rates only, as on a processor that qemu emulates."""
    master, port = pty.openpty()
    try:
        serial.Serial(os.ttyname(port), 12_000_000).close()
    except ValueError as error:
        if not isinstance(error.__context__, OSError) or error.__context__.errno != errno.ENOSYS:
            raise
        pytest.skip(f"no system call for other than the usual baud rates: {error}")
    finally:
        os.close(master)
        os.close(port)


@pytest.fixture
def files_end_at() -> Callable[[int], AbstractContextManager[None]]:
    """Set the largest size of a file in a block: a write beyond it fails as on a full disk.

    The log of the tests is a file too, and may be larger when their results are written.
    """

    @contextmanager
    def files_end_at(size: int) -> Iterator[None]:
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))

    return files_end_at


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[str, str]]:
    """Run a command line; check its exit code, and return what it printed, as `out` and `err`."""
    from edge_vpr_tools.cli import main

    def run(*words: object, code: int = 0) -> tuple[str, str]:
        capsys.readouterr()
        ended = main([str(word) for word in words])
        printed = capsys.readouterr()
        assert ended == code, printed.err
        return printed

    return run


@pytest.fixture
def refused(run: Callable[..., tuple[str, str]]) -> Callable[..., str]:
    """Run a command line that is refused; return its error, which is one line."""
    from edge_vpr.run_log import COMPILING

    def refused(*words: object, code: int = 2) -> str:
        err = run(*words, code=code)[1].removeprefix(f"edge-vpr: {COMPILING}\n")
        assert err.startswith("edge-vpr: error: ") and err.count("\n") == 1, err
        return err

    return refused
