"""Type of a file's file system: SQLite's write-ahead log needs memory shared between its users."""

from pathlib import Path

_NETWORK_FILESYSTEMS = (
    *("9p", "acfs", "afs", "beegfs", "ceph", "cifs", "gfs", "gfs2", "gpfs", "lustre", "ncpfs", "nfs", "nfs4", "ocfs2"),
    *("orangefs", "panfs", "pvfs2", "smb3", "smbfs", "virtiofs", "wekafs"),
)


def filesystem_type(path: Path, mountinfo: str | None = None) -> str | None:
    """Type of the file system of a path, such as ``"ext4"``; None if unknown (no /proc).

    The path need not exist yet. ``mountinfo`` is a text in the format of ``/proc/self/mountinfo`` (proc(5)), by default
    this file.
    """
    if mountinfo is None:
        try:
            mountinfo = Path("/proc/self/mountinfo").read_text(encoding="utf-8", errors="surrogateescape")
        except OSError:
            return None
    resolved = path.resolve()
    found: tuple[int, str] | None = None
    for line in mountinfo.splitlines():
        before, separator, after = line.partition(" - ")
        fields = before.split()
        if not separator or len(fields) < 5:  # the mount point is the fifth field
            continue
        mount_point = Path(_unescape(fields[4]))
        depth = len(mount_point.parts)
        # A later mount on the same point hides the earlier one, hence >=.
        if resolved.is_relative_to(mount_point) and (found is None or depth >= found[0]):
            found = (depth, after.split()[0])
    return found[1] if found else None


def is_network_filesystem(path: Path, mountinfo: str | None = None) -> bool:
    """Whether a path is on a network or cluster file system.

    Every ``fuse.*`` type counts as one (sshfs, glusterfs, s3fs ...): a wrong yes costs speed, a wrong no costs data.
    """
    kind = filesystem_type(path, mountinfo)
    return kind is not None and (kind in _NETWORK_FILESYSTEMS or kind.startswith("fuse."))


def _unescape(field: str) -> str:
    """Undo the octal escapes of space, tab, newline and backslash in mountinfo."""
    for code, character in (("\\040", " "), ("\\011", "\t"), ("\\012", "\n"), ("\\134", "\\")):
        field = field.replace(code, character)
    return field
