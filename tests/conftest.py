"""Fixtures that many tests share."""

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("roomeq", deadline=None)  # a busy machine is no failure
settings.load_profile("roomeq")
PROJECT = Path(__file__).resolve().parents[1]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark every test with its tier, the folder of `tests` that it lies in: unit, integration or nightly."""
    for item in items:
        item.add_marker(item.path.relative_to(PROJECT / "tests").parts[0])


@pytest.fixture
def default_hangup() -> Iterator[None]:
    """A hang-up ends what a test starts, as in a terminal: after nohup, all processes ignore it."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.fixture(scope="session")
def project_dir() -> Path:
    """The directory that `run.sh` lies in."""
    return PROJECT


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real recordings beside the project; tests that need them are skipped where they are absent."""
    return _shared("data", "the real recordings")


@pytest.fixture(scope="session")
def shared_repro() -> Path:
    """Inputs beside the project that once failed; tests that need them are skipped where they are absent."""
    return _shared("repro", "the inputs")


def _shared(name: str, content: str) -> Path:
    path = PROJECT.parent / "shared" / name
    if not path.is_dir():
        pytest.skip(f"needs {content} in {path}")
    return path
