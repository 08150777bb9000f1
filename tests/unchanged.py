"""Files that a refusal leaves as they were."""

import hashlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path


def digests(folders: Iterable[Path]) -> dict[str, str]:
    """Digest of every file in some folders, by its path."""
    return {
        str(path): hashlib.sha256(path.read_bytes()).hexdigest()
        for folder in folders
        for path in sorted(folder.rglob("*"))
        if path.is_file() and "__pycache__" not in path.parts
    }


@contextmanager
def unchanged_if_refused(*folders: Path) -> Iterator[list[object]]:
    """Give a list for exit codes; if one of them is 2, no file of the folders may have changed, come or gone."""
    before, codes = digests(folders), list[object]()
    yield codes
    if 2 in codes:
        after = digests(folders)
        changed = {path for path in before | after if before.get(path) != after.get(path)}
        assert not changed, f"a refused command changed {sorted(changed)}"
