"""The installation holds the pinned packages and nothing else, whatever happened to `.venv`, or says why it does not.

A small tree with the real scripts, two packages and its own build backend stands for the recipe: no network is needed.
"""

import compileall
import hashlib
import importlib.metadata
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

NIGHTLY = pytest.mark.nightly  # each of these makes an environment
SCRIPTS = ("path.sh", "local/install.sh", "local/check_environment.py", "local/explain_pip.py")
BACKEND = """
import sys
sys.path.insert(0, "local")
from small_wheel import write_wheel
def build_editable(directory, config_settings=None, metadata_directory=None):
    scripts = "[console_scripts]\\nroomeq = roomeq:main\\n"
    return write_wheel(directory, "roomeq", "1.0", {"_roomeq.pth": "pysrc\\n"}, scripts)
"""
PYPROJECT = """[build-system]
requires = []
build-backend = "backend"
backend-path = ["local"]
[project]
name = "roomeq"
version = "1.0"
"""
SMALL_WHEEL = '''
import base64, hashlib, os, zipfile
def write_wheel(directory, name, version, files, entry_points=""):
    info = f"{name}-{version}.dist-info"
    files = dict(files) | {f"{info}/METADATA": f"Metadata-Version: 2.1\\nName: {name}\\nVersion: {version}\\n",
                           f"{info}/WHEEL": "Wheel-Version: 1.0\\nRoot-Is-Purelib: true\\nTag: py3-none-any\\n"}
    if entry_points:
        files[f"{info}/entry_points.txt"] = entry_points
    digest = lambda text: base64.urlsafe_b64encode(hashlib.sha256(text.encode()).digest()).decode().rstrip("=")
    files[f"{info}/RECORD"] = "".join(f"{path},sha256={digest(text)},{len(text)}\\n" for path, text in files.items())
    wheel = f"{name}-{version}-py3-none-any.whl"
    with zipfile.ZipFile(os.path.join(directory, wheel), "w") as archive:
        for path, text in files.items():
            archive.writestr(zipfile.ZipInfo(path), text)
    return wheel
'''


def write_wheel(directory: Path, name: str, version: str) -> str:
    """Write a wheel of one module, and return its line for a requirements file."""
    scope: dict = {}
    exec(SMALL_WHEEL, scope)
    wheel = directory / scope["write_wheel"](directory, name, version, {f"{name}.py": f"version = {version!r}\n"})
    return f"{name}=={version} \\\n    --hash=sha256:{hashlib.sha256(wheel.read_bytes()).hexdigest()}\n"


def make_tree(tree: Path, project_dir: Path, pins: str) -> Path:
    for name in SCRIPTS:
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(project_dir / name, tree / name)
    (tree / "pysrc/roomeq").mkdir(parents=True)
    (tree / "pysrc/roomeq/__init__.py").write_text("def main(): print(__file__)\n")
    (tree / "pysrc/roomeq/compile_kernels.py").touch()
    for name, text in (("pyproject.toml", PYPROJECT), ("local/backend.py", BACKEND), ("requirements.txt", pins),
                       ("local/small_wheel.py", SMALL_WHEEL), ("local/build-requirements.txt", "")):
        (tree / name).write_text(text)
    return tree


@pytest.fixture(scope="module")
def wheels(tmp_path_factory):
    """Two versions of a package; the requirements pin the first. `python3` makes environments fast (no ensurepip)."""
    folder = tmp_path_factory.mktemp("wheels")
    pins = write_wheel(folder, "alpha", "1.0")
    write_wheel(folder, "alpha", "2.0")
    (folder / "pins.txt").write_text(pins + write_wheel(folder, "beta", "1.0"))
    files = importlib.metadata.distribution("pip").files
    assert files
    for file in files:
        path = folder / "pip" / os.path.relpath(file.locate(), sys.prefix)
        if file.hash or file.name == "RECORD":
            path.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(file.locate(), path)
    compileall.compile_dir(folder / "pip", quiet=1)
    (folder / "bin").mkdir()
    (folder / "bin/python3").write_text(f"""#!/bin/bash
[ "$*" = "-m venv .venv" ] || exec {sys.executable} "$@"
{sys.executable} -m venv --without-pip .venv && cp -a {folder}/pip/. .venv/
""")
    (folder / "bin/python3").chmod(0o755)
    return folder


@pytest.fixture(scope="module")
def made(tmp_path_factory, wheels, project_dir):
    """A tree with its environment, which each test leaves as it was."""
    tree = make_tree(tmp_path_factory.mktemp("made") / "a tree", project_dir, (wheels / "pins.txt").read_text())
    done = install(tree, wheels)
    assert done.returncode == 0, done.stderr
    return tree


@pytest.fixture
def tree(made, wheels):
    """The tree, after a check that the last test left it whole."""
    assert_whole(made, install(made, wheels))
    return made


def environment(wheels, **variables):
    return {"PATH": f"{wheels / 'bin'}:/usr/bin:/bin", "HOME": str(wheels), "PIP_CONFIG_FILE": "/dev/null",
            "PIP_NO_INDEX": "1", "PIP_FIND_LINKS": str(wheels), "PIP_NO_CACHE_DIR": "1", **variables}


def install(tree, wheels, **variables):
    return subprocess.run(["local/install.sh"], cwd=tree, env=environment(wheels, **variables), capture_output=True,
                          text=True, timeout=120)


def run(tree, wheels, command, **variables):
    return subprocess.run(["bash", "-c", f". ./path.sh && {command}"], cwd=tree, capture_output=True, text=True,
                          env=environment(wheels, **variables), timeout=60)


def assert_whole(tree, done):
    assert (done.returncode, done.stderr) == (0, "")
    site = site_of(tree)
    assert (site / "alpha.py").read_text() == "version = '1.0'\n" and (site / "beta.py").exists()
    called = subprocess.run([tree / ".venv/bin/roomeq"], capture_output=True, text=True, cwd="/",
                            env={"PYTHONPATH": str(tree / "pysrc")})
    assert called.stdout == f"{tree}/pysrc/roomeq/__init__.py\n"
    assert (tree / ".venv/bin/roomeq").read_bytes()[:500].count(f"{tree}/.venv/bin/python".encode()) == 1
    assert not (tree / ".venv.old").exists()


def assert_one_line(done, *parts):
    assert done.returncode == 1 and done.stderr.count("\n") == 1 and done.stderr.startswith("install.sh: "), done.stderr
    for part in parts:
        assert part in done.stderr


def site_of(tree):
    return next((tree / ".venv/lib").glob("python*/site-packages"))


def test_whole_environment_is_left_alone(tree, wheels):
    before = {path: path.stat().st_mtime_ns for path in tree.rglob("*")}
    done = install(tree, wheels, PIP_FIND_LINKS="/nowhere")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert before == {path: path.stat().st_mtime_ns for path in tree.rglob("*")}


def test_mark_of_other_requirements_does_not_count(tree, wheels):
    for mark in (tree / ".venv").glob(".installed-*"):
        mark.unlink()
    done = install(tree, wheels, PIP_FIND_LINKS="/nowhere")
    assert_whole(tree, done)
    assert done.stdout == ""


def test_package_of_another_version_is_replaced(tree, wheels):
    run(tree, wheels, "python -m pip install --quiet alpha==2.0")
    assert (site_of(tree) / "alpha.py").read_text() == "version = '2.0'\n"
    done = install(tree, wheels)
    assert_whole(tree, done)
    assert "made again" not in done.stdout


def empty(path):
    path.write_bytes(b"")


@pytest.mark.parametrize("damage, name, reason", [
    pytest.param(os.unlink, "alpha-1.0.dist-info/RECORD", "RECORD cannot be read: the installation was not finished",
                 id="no-record", marks=NIGHTLY),
    pytest.param(os.unlink, "beta.py", "beta.py is missing", id="no-module", marks=NIGHTLY),
    pytest.param(empty, "alpha.py", "alpha.py is not as it was installed", id="empty-module"),
    pytest.param(empty, "pip/_vendor/packaging/requirements.py", "its pip cannot be imported", id="half-pip"),
    pytest.param(os.unlink, "pip/_internal/cli/main.py", "main.py is missing", id="pip-lacks-a-file", marks=NIGHTLY),
    pytest.param(lambda path: shutil.copytree(path, path.with_name("alpha-0.9.dist-info")), "alpha-1.0.dist-info",
                 "alpha is there twice", id="two-versions", marks=NIGHTLY),
])
def test_damaged_environment_is_made_again(tree, wheels, damage, name, reason):
    damage(site_of(tree) / name)
    for mark in (tree / ".venv").glob(".installed-*"):  # as after a killed installation
        mark.unlink()
    done = install(tree, wheels)
    assert_whole(tree, done)
    assert "made again: " in done.stdout and reason in done.stdout


@pytest.mark.parametrize("wait_s", [1.0] + [pytest.param(wait_s, marks=NIGHTLY) for wait_s in (0.2, 0.4, 0.7, 1.5, 2)])
def test_killed_installation_is_continued(tree, wheels, wait_s):
    shutil.rmtree(tree / ".venv")
    process = subprocess.Popen(["local/install.sh"], cwd=tree, env=environment(wheels), start_new_session=True,
                               stdout=subprocess.DEVNULL)
    time.sleep(wait_s)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    assert_whole(tree, install(tree, wheels))


@NIGHTLY
def test_two_installations_at_once_make_one_environment(tree, wheels):
    shutil.rmtree(tree / ".venv")
    both = [subprocess.Popen(["local/install.sh"], cwd=tree, env=environment(wheels), stdout=subprocess.DEVNULL)
            for _ in range(2)]
    assert [process.wait(120) for process in both] == [0, 0]
    assert_whole(tree, install(tree, wheels))


@NIGHTLY
def test_moved_tree_gets_a_new_environment(tree, wheels):
    moved = tree.with_name("moved")
    tree.rename(moved)
    try:
        done = install(moved, wheels)
        assert_whole(moved, done)
        assert f"it was made in {tree}/.venv and moved or copied" in done.stdout
    finally:
        moved.rename(tree)
        install(tree, wheels)


def test_copied_environment_is_not_used(tree, wheels, project_dir):
    """Its scripts would run the packages of the tree that it was copied from."""
    copy = make_tree(tree.with_name("copy"), project_dir, (tree / "requirements.txt").read_text())
    shutil.copytree(tree / ".venv", copy / ".venv", symlinks=True)
    done = install(copy, wheels)
    assert_whole(copy, done)
    assert f"it was made in {tree}/.venv" in done.stdout


def test_moved_environment_stays_where_no_package_is_to_be_had(tree, wheels):
    moved = tree.with_name("offline")
    tree.rename(moved)
    try:
        assert_one_line(install(moved, wheels, PIP_FIND_LINKS="/nowhere"), "pip reaches no index that has alpha==1.0: ")
        assert not (moved / ".venv.old").exists()
    finally:
        moved.rename(tree)
    assert_whole(tree, install(tree, wheels, PIP_FIND_LINKS="/nowhere"))


def remove_python(tree):
    for name in ("python", "python3"):
        path = tree / ".venv/bin" / name
        path.unlink()
        path.symlink_to("/nowhere/bin/python3")


def change_python(tree):
    site_of(tree).parent.rename(tree / ".venv/lib/python3.1")


def damage_python(tree):
    (tree / ".venv/bin/python").unlink()
    (tree / ".venv/bin/python").write_text("#!/bin/false\n")
    (tree / ".venv/bin/python").chmod(0o755)


@pytest.mark.parametrize("change, reason", [
    (remove_python, "its Python /nowhere/bin/python3 is gone"),
    pytest.param(change_python, "it was made for another Python", marks=NIGHTLY),
    pytest.param(damage_python, "is gone or does not run", marks=NIGHTLY),
])
def test_environment_without_its_python_is_made_again(tree, wheels, change, reason):
    change(tree)
    done = install(tree, wheels)
    assert_whole(tree, done)
    assert reason in done.stdout


def test_linked_environment_is_used_but_never_changed(tree, wheels, tmp_path, project_dir):
    other = make_tree(tmp_path / "other", project_dir, (tree / "requirements.txt").read_text())
    (other / ".venv").symlink_to(tree / ".venv")
    assert install(other, wheels).returncode == 0
    (other / "requirements.txt").write_text(write_wheel(tmp_path, "gamma", "1.0"))
    assert_one_line(install(other, wheels, PIP_FIND_LINKS=str(tmp_path)),
                    f".venv is a link to {tree}/.venv, where gamma must be 1.0 and is absent: run local/install.sh "
                    "there")
    assert not (site_of(tree) / "gamma.py").exists()


def test_package_with_another_hash_is_refused(tree, wheels, tmp_path):
    pins = (tree / "requirements.txt").read_text()
    try:
        write_wheel(tmp_path, "gamma", "1.0")
        (tree / "requirements.txt").write_text(pins + f"gamma==1.0 \\\n    --hash=sha256:{'0' * 64}\n")
        assert_one_line(install(tree, wheels, PIP_FIND_LINKS=f"{tmp_path} {wheels}"),
                        "gamma is not the file that the requirements pin by hash")
        assert not (site_of(tree) / "gamma.py").exists()
    finally:
        (tree / "requirements.txt").write_text(pins)


def test_version_that_is_nowhere_is_named(tree, wheels):
    pins = (tree / "requirements.txt").read_text()
    try:
        (tree / "requirements.txt").write_text(pins.replace("alpha==1.0", "alpha==3.0"))
        assert_one_line(install(tree, wheels), "there is no alpha==3.0 for this Python and machine")
    finally:
        (tree / "requirements.txt").write_text(pins)


def test_package_without_a_hash_is_refused(tree, wheels):
    pins = (tree / "requirements.txt").read_text()
    try:
        (tree / "requirements.txt").write_text("alpha==2.0\n")
        assert_one_line(install(tree, wheels), "hashes")
    finally:
        (tree / "requirements.txt").write_text(pins)


def test_unreachable_index_is_named(tree, wheels):
    shutil.rmtree(tree / ".venv")
    done = install(tree, wheels, PIP_NO_INDEX="0", PIP_FIND_LINKS="", PIP_RETRIES="0",
                   PIP_INDEX_URL="http://127.0.0.1:9/simple")
    assert_one_line(done, "pip reaches no index that has alpha==1.0: connect to the network, or name a mirror")


@NIGHTLY
@pytest.mark.parametrize("variable, value", [("PIP_TARGET", "/nowhere/target"), ("PIP_USER", "1"), ("PIP_PREFIX", "x"),
                                             ("PIP_NO_BINARY", ":all:"), ("PIP_REQUIRE_HASHES", "1")])
def test_variables_of_pip_lead_nowhere_else(tree, wheels, variable, value):
    shutil.rmtree(tree / ".venv")
    assert_whole(tree, install(tree, wheels, **{variable: value}))


def test_pip_that_installs_elsewhere_is_named(tree, wheels, tmp_path):
    shutil.rmtree(tree / ".venv")
    (tmp_path / "pip.conf").write_text(f"[install]\ntarget = {tmp_path}/target\n")
    assert_one_line(install(tree, wheels, PIP_CONFIG_FILE=str(tmp_path / "pip.conf")),
                    "after the installation, in .venv: ", "is absent: does pip's configuration", "as target or prefix?")


def test_environment_put_aside_by_a_killed_run_is_removed(tree, wheels):
    (tree / ".venv.old").mkdir()
    assert_whole(tree, install(tree, wheels, PIP_FIND_LINKS="/nowhere"))


def test_too_old_python_is_named(tree, wheels, tmp_path):
    shutil.rmtree(tree / ".venv")
    for name in ("bash", "cat", "cut", "env", "flock", "readlink", "sha256sum", "uname"):
        (tmp_path / name).symlink_to(shutil.which(name))
    for name in ("python3", "python3.11", "python3.12", "python3.13", "python3.14"):
        (tmp_path / name).write_text("#!/bin/sh\n[ $1 = --version ] && echo Python 3.9.2\n")
        (tmp_path / name).chmod(0o755)
    done = install(tree, wheels, PATH=str(tmp_path))
    assert_one_line(done, "Python 3.11, 3.12, 3.13 or 3.14 is needed: PATH has Python 3.9.2")


def test_pinned_packages_win_over_a_users_pythonpath(tree, wheels, tmp_path):
    (tmp_path / "alpha.py").write_text("version = 'of the user'\n")
    done = run(tree, wheels, "python -c 'import alpha; print(alpha.version)'", PYTHONPATH=str(tmp_path))
    assert done.stdout == "1.0\n"
    assert done.stderr == (f"path.sh: PYTHONPATH='{tmp_path}' is ignored: the recipe runs with the packages that it "
                           "pins\n")
    done = run(tree, wheels, ". ./path.sh && bash -c '. ./path.sh'")
    assert (done.returncode, done.stderr) == (0, "")


def test_pythonhome_does_not_reach_python(tree, wheels):
    assert run(tree, wheels, "python -c 'import alpha'", PYTHONHOME="/nowhere").returncode == 0


@pytest.mark.parametrize("name", ["a:b", 'a"b', "a$HOME", "a`b", "a\\b"])
def test_directory_that_no_environment_can_lie_in_is_named(tmp_path, wheels, project_dir, name):
    done = install(make_tree(tmp_path / name, project_dir, ""), wheels)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith(f"path.sh: the directory '{tmp_path / name}' must be renamed: ")
    assert done.stderr.count("\n") == 1


@NIGHTLY
@pytest.mark.parametrize("name", ["a b", "ä'", "a;b&c", "x" * 150])
def test_directory_with_an_odd_name_gets_an_environment(tmp_path, wheels, project_dir, name):
    tree = make_tree(tmp_path / name, project_dir, (wheels / "pins.txt").read_text())
    assert_whole(tree, install(tree, wheels))
    assert_whole(tree, install(tree, wheels, PIP_FIND_LINKS="/nowhere"))
