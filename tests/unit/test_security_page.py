"""SECURITY.md names modules and tests that exist."""

import re


def test_every_path_on_the_security_page_exists(project_dir):
    text = (project_dir / "SECURITY.md").read_text()
    paths = {path for path in re.findall(r"`([a-z_]+(?:/[\w.]+)+|\w+\.(?:sh|txt))`", text) if "__pycache__" not in path}
    assert len(paths) > 25 and {path for path in paths if not (project_dir / path).exists()} == set()
