"""Version and commit of this source. Wheel, command and all other files take the version from here."""

from pathlib import Path

__version__ = "1.0.0"


def source_commit() -> tuple[str | None, bool | None]:
    """Commit of the running source, and whether it was changed; None if unknown, as for most wheels."""
    import json  # noqa: PLC0415 - every import of calcidem loads this module, and few ask for the commit
    import subprocess  # noqa: PLC0415 - as above
    from importlib.metadata import PackageNotFoundError, distribution  # noqa: PLC0415 - as above

    root = Path(__file__).parents[1]
    if not (root / ".git").exists():  # pip records what it installed from a repository (PEP 610)
        try:
            noted = json.loads(distribution("calcidem").read_text("direct_url.json") or "{}")
        except PackageNotFoundError:
            return None, None
        installed = noted.get("vcs_info", {}).get("commit_id")
        return installed, False if installed else None
    command = ["git", "-C", str(root), "describe", "--always", "--abbrev=40", "--exclude=*", "--dirty"]
    try:
        done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=10)  # noqa: S603 - fixed
    except (OSError, subprocess.SubprocessError):  # also without git
        return None, None
    commit, _, changed = done.stdout.strip().partition("-")
    return commit, bool(changed)
