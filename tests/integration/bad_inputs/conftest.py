"""Fixtures of the bad inputs."""

import os
import warnings

import pytest
from right import WORLDS


@pytest.fixture(scope="session")
def worlds(tmp_path_factory):
    """A directory with one right input of every kind, paths in them relative to it."""
    root, before = tmp_path_factory.mktemp("worlds"), os.getcwd()
    os.chdir(root)
    try:
        for name, make in WORLDS.items():
            make(root.relative_to(root) / name)
    finally:
        os.chdir(before)
    return root


@pytest.fixture
def strict():
    """Make every warning an error: a user would see it as lines beside the message."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield
