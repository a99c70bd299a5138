#!/usr/bin/env python3
"""Check that the Python environment that runs this holds the pinned packages, file by file, and lies where it was made.

Usage: .venv/bin/python -I local/check_environment.py <requirements.txt>...

Prints, relative to the environment, the files that list what was installed. What is wrong is one line on stderr and
the exit status: 1 if a package is absent or of another version, which pip mends; 2 if a new environment is needed.
"""

import base64
import csv
import hashlib
import re
import sys
import sysconfig
from collections import Counter
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path


class Unfit(Exception):
    """The environment cannot be used or mended."""


def pinned(requirements: list[str]) -> dict[str, str]:
    """Return versions by normalised name, of the packages that requirements files pin for this Python and machine."""
    try:
        from pip._vendor.packaging.requirements import Requirement
    except Exception as error:  # a package that is half there fails in any way
        raise Unfit(f"its pip cannot be imported ({type(error).__name__})") from None
    versions = {}
    for name in requirements:
        for line in Path(name).read_text(encoding="utf-8").splitlines():
            if re.match(r"[A-Za-z0-9]", line):
                requirement = Requirement(line.rstrip("\\"))
                if not requirement.marker or requirement.marker.evaluate():
                    versions[normalised(requirement.name)] = str(requirement.specifier).removeprefix("==")
    return versions


def normalised(name: str) -> str:
    """Return the name of a package as it is compared: the form of PEP 503."""
    return re.sub(r"[-_.]+", "-", name).lower()


def installed(site: Path) -> dict[str, list[Path]]:
    """Return the metadata folders of each installed package."""
    folders: dict[str, list[Path]] = {}
    for folder in sorted(site.glob("*.dist-info")):
        folders.setdefault(normalised(folder.name.partition("-")[0]), []).append(folder)
    return folders


def listed_files(folder: Path) -> dict[str, str]:
    """Return the hashes of a package's files by name; those that Python compiled, and compiles again, are left out."""
    try:
        with open(folder / "RECORD", newline="", encoding="utf-8") as stream:
            files = {row[0]: row[1] for row in csv.reader(stream)}
    except (OSError, ValueError, IndexError, csv.Error):
        files = {}
    return {name: content_hash for name, content_hash in files.items() if content_hash}


def check_files(site: Path, files: dict[str, str], shared: set[str]) -> None:
    """Raise `Unfit` unless every file of a package is as listed; of those that another package has too, any will do."""
    for name, recorded in files.items():
        if ".cpython-" in name and name.endswith(".so") and not name.endswith(tuple(EXTENSION_SUFFIXES)):
            raise Unfit(f"{site / name} is for another Python or another machine")
        try:
            content = (site / name).read_bytes()
        except OSError:
            raise Unfit(f"{site / name} is missing or cannot be read") from None
        algorithm, _, content_hash = recorded.partition("=")
        actual = base64.urlsafe_b64encode(hashlib.new(algorithm, content).digest()).decode().rstrip("=")
        if actual != content_hash and name not in shared:
            raise Unfit(f"{site / name} is not as it was installed")


def check_place(environment: Path) -> None:
    """Raise `Unfit` if the environment's scripts call the Python of another one: it was moved or copied."""
    try:
        head = (environment / "bin" / "roomeq").read_bytes()[:8192].decode(errors="surrogateescape")
    except FileNotFoundError:
        raise LookupError("roomeq is absent") from None
    except OSError as error:
        raise Unfit(f"bin/roomeq: {error.strerror}") from None
    called = re.match(r"#!(?:/bin/sh\n'''exec' )?\"?(/[^\n\"]*?)/bin/python[0-9.]*[\"\s]", head)
    if not called or Path(called[1]) != environment:
        raise Unfit(f"it was made in {called[1] if called else 'another directory'} and moved or copied")


def check(environment: Path, site: Path, requirements: list[str]) -> list[Path]:
    """Return the lists of files of all pinned packages.

    Raises
    ------
    Unfit
        The environment has to be made anew.
    LookupError
        A package is absent, or has another version.
    """
    if not site.is_dir():
        raise Unfit(f"it was made for another Python than its present one, {sys.version.split()[0]}")
    folders = installed(site)
    if "pip" not in folders:
        raise Unfit("it has no pip")
    versions = pinned(requirements)
    files = {name: listed_files(found[0]) for name, found in folders.items()}
    shared = {name for name, count in Counter(name for names in files.values() for name in names).items() if count > 1}
    absent = []
    for name in ["pip", *versions]:
        found = folders.get(name, [])
        if len(found) > 1:
            raise Unfit(f"{name} is there twice: {found[0].name} and {found[1].name}")
        if found and not files[name]:
            raise Unfit(f"{found[0] / 'RECORD'} cannot be read: the installation was not finished")
        if found:
            check_files(site, files[name], shared)
        actual = found[0].name.removesuffix(".dist-info").partition("-")[2] if found else "absent"
        if actual != versions.get(name, actual):
            absent.append(f"{name} must be {versions[name]} and is {actual}")
    if "roomeq" in folders:
        check_place(environment)
    else:
        absent.append("roomeq is absent")
    if absent:
        raise LookupError(absent[0])
    return [folders[name][0] / "RECORD" for name in versions] + [environment / "bin" / "roomeq"]


def main() -> int:
    environment = Path(sys.prefix).resolve()
    site = Path(sysconfig.get_path("purelib")).resolve()
    try:
        lists = check(environment, site, sys.argv[1:])
    except (LookupError, Unfit) as error:
        print(error, file=sys.stderr)
        return 2 if isinstance(error, Unfit) else 1
    print("\n".join(str(path.relative_to(environment)) for path in lists))
    return 0


if __name__ == "__main__":
    sys.exit(main())
