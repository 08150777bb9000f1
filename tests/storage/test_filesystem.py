"""Recognising network file systems from /proc/self/mountinfo."""

from pathlib import Path

import pytest

from calcidem.storage.files import filesystem_type, is_network_filesystem

MOUNTINFO = r"""
22 1 8:1 / / rw,relatime shared:1 - ext4 /dev/sda1 rw
30 22 0:25 / /home rw,relatime shared:5 - nfs4 server:/home rw,vers=4.2
31 22 0:26 / /home/local rw - xfs /dev/sdb1 rw
32 22 0:27 / /scratch rw master:3 propagate_from:2 - lustre mgs@tcp:/scratch rw
33 22 0:28 / /mnt/my\040share rw - cifs //server/share rw
34 22 0:29 / /over rw - ext4 /dev/sdc1 rw
35 22 0:30 / /over rw - beegfs beegfs_nodev rw
36 22 0:31 / /remote rw - fuse.sshfs me@server: rw
37 22 0:32 / /usb rw - fuseblk /dev/sdd1 rw
"""


@pytest.mark.parametrize(
    ("path", "kind", "is_network"),
    [
        ("/work/paper.db", "ext4", False),
        ("/home/me/paper.db", "nfs4", True),
        ("/home/local/paper.db", "xfs", False),
        ("/homeless/paper.db", "ext4", False),
        ("/scratch/deep/er/paper.db", "lustre", True),
        ("/mnt/my share/paper.db", "cifs", True),
        ("/over/paper.db", "beegfs", True),
        ("/remote/paper.db", "fuse.sshfs", True),
        ("/usb/paper.db", "fuseblk", False),
    ],
)
def test_type_of_deepest_latest_mount(path: str, kind: str, is_network: bool) -> None:
    """A path belongs to the deepest mount above it, the latest where two share a point."""
    assert filesystem_type(Path(path), MOUNTINFO) == kind
    assert is_network_filesystem(Path(path), MOUNTINFO) is is_network


def test_this_machine(tmp_path: Path) -> None:
    """The real /proc gives some type for a real folder."""
    assert filesystem_type(tmp_path)
