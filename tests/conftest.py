"""What all tests share: real data where it lies, and patience with compilers."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
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


SHARED_DATA = Path(__file__).parents[1].parent / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real recordings, which are not part of the project."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"real data is not at {SHARED_DATA}")
    return SHARED_DATA
