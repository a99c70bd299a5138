"""Packages that only some functions need, and the extra of roomeq that installs each."""

from importlib.util import find_spec

_EXTRA_OF = {"jinja2": "report", "markupsafe": "report", "matplotlib": "report", "rapidfuzz": "wer", "sofar": "sofa",
             "trimesh": "mesh"}


def require_packages(*names: str) -> None:
    """Raise a `ModuleNotFoundError` that names the remedy where a package is not installed."""
    for name in names:
        if find_spec(name) is None:
            raise ModuleNotFoundError(absent(name), name=name)


def absent(name: str) -> str:
    """Return the message for a package that is not installed."""
    extra = _EXTRA_OF.get(name)
    return (f"the package {name} is not installed: "
            + (f"pip install 'roomeq[{extra}]'" if extra else "install roomeq again"))
