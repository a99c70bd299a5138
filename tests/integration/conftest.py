"""Fixtures of the integration tests."""

import pytest
from scripts import SCRIPT


@pytest.fixture
def recipe(tmp_path, project_dir):
    """A directory with our utils and one small script in it."""
    (tmp_path / "utils").symlink_to(project_dir / "utils")
    (tmp_path / "say.sh").write_text(SCRIPT)
    (tmp_path / "say.sh").chmod(0o755)
    return tmp_path
