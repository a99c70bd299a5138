"""The requirements pin every package that the recipe installs, each by the hashes of its files."""

import re
import tomllib
from pathlib import Path

import pytest

FILES = ("requirements.txt", "tests/requirements.txt", "docs/requirements.txt")
BUILD = "local/build-requirements.txt"


def pins(path: Path) -> dict[str, list[str]]:
    """Return the versions of each package, and check the form of every line."""
    versions: dict[str, list[str]] = {}
    hashes = 1
    for line in path.read_text().splitlines():
        pin = re.fullmatch(r"([a-z0-9-]+)==([0-9a-z.]+)( ; [a-z_]+ (?:==|<|>=) '[0-9a-z_.]+')? \\", line)
        assert pin or re.fullmatch(r"    --hash=sha256:[0-9a-f]{64}( \\)?", line), line
        if pin:
            assert hashes, line
            versions.setdefault(pin[1], []).append(pin[2])
        hashes = 0 if pin else hashes + 1
    assert hashes
    return versions


@pytest.mark.parametrize("name", [*FILES, BUILD])
def test_every_pin_has_a_hash_and_nothing_names_an_address(project_dir, name):
    assert pins(project_dir / name)


def test_no_package_is_pinned_in_two_files(project_dir):
    names = [package for name in FILES for package in pins(project_dir / name)]
    assert len(names) == len(set(names))


def test_build_tools_have_the_versions_of_the_other_pins(project_dir):
    others = {package: versions for name in FILES for package, versions in pins(project_dir / name).items()}
    build = pins(project_dir / BUILD)
    assert {package: others.get(package, build[package]) for package in build} == build


def test_dependencies_and_build_system_are_pinned(project_dir):
    project = tomllib.loads((project_dir / "pyproject.toml").read_text())
    extras = [line for lines in project["project"]["optional-dependencies"].values() for line in lines]
    required = {re.split(r"[><=\[]", line)[0] for line in project["project"]["dependencies"] + extras} - {"roomeq"}
    assert required <= set(pins(project_dir / "requirements.txt"))
    built_with = {re.split(r"[><=]", line)[0] for line in project["build-system"]["requires"]}
    assert built_with | {"pip"} <= set(pins(project_dir / BUILD))
