"""Whether the libraries that are installed have known vulnerabilities."""

import json
import subprocess
import sys

import pytest

pytestmark = pytest.mark.full


def test_no_library_has_a_known_vulnerability() -> None:
    """pip-audit finds none in this environment, as far as its service can be reached."""
    pytest.importorskip("pip_audit", reason="pip-audit is not installed (pip install 'calcidem[audit]')")
    command = [sys.executable, "-m", "pip_audit", "--local", "--skip-editable", "--progress-spinner=off"]
    done = subprocess.run([*command, "--format=json"], check=False, capture_output=True, text=True)
    if not done.stdout.strip():  # what it cannot ask it answers with an error alone
        pytest.skip(f"the service of pip-audit cannot be reached: {done.stderr.strip().splitlines()[-1][:200]}")
    libraries = json.loads(done.stdout)["dependencies"]
    assert len(libraries) > 50
    found = {
        library["name"]: [known["id"] for known in library["vulns"]] for library in libraries if library.get("vulns")
    }
    assert not found
