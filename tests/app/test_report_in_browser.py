"""The report in a real browser: complete, quiet, and as wide as the screen."""

import json
import re
import shutil
import struct
import subprocess
import zlib
from pathlib import Path

import pytest

pytestmark = pytest.mark.full

PROBE = """<script>
addEventListener("load", () => {
  const pictures = [...document.images];
  const probe = document.createElement("pre");
  probe.id = "probe";
  probe.textContent = JSON.stringify({
    pictures: pictures.length,
    broken: pictures.filter(p => !p.complete || p.naturalWidth === 0).map(p => p.alt),
    page: document.documentElement.scrollWidth,
    window: innerWidth,
    small: [...document.querySelectorAll("td, p, figcaption, dd")]
      .filter(e => parseFloat(getComputedStyle(e).fontSize) < 12).length,
  });
  document.body.append(probe);
});
</script></body>"""


@pytest.fixture(scope="module")
def browser() -> str:
    """Path of Chromium."""
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if found is None:
        pytest.skip("Chromium is not installed (Debian: apt-get install --no-install-recommends chromium)")
    return found


def run_browser(browser: str, page: Path, width: int, *options: str) -> subprocess.CompletedProcess[str]:
    """Open a page in a window of a width, in pixels, with a profile of its own."""
    profile = page.parent / f"profile-{width}"
    command = [
        browser,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--hide-scrollbars",
        "--enable-logging=stderr",
        f"--user-data-dir={profile}",
        f"--window-size={width},2400",
        *options,
        page.as_uri(),
    ]
    return subprocess.run(command, check=True, capture_output=True, text=True, timeout=120)


@pytest.mark.parametrize("width", [390, 1280])
def test_page_is_complete_and_fits(browser: str, small_report: Path, width: int) -> None:
    """Every picture loads, nothing is wider than the screen, no text is tiny, the console stays empty."""
    probed = small_report.with_name(f"probed-{width}.html")
    probed.write_text(small_report.read_text(encoding="utf-8").replace("</body>", PROBE), encoding="utf-8")
    done = run_browser(browser, probed, width, "--dump-dom")
    found = re.search(r'<pre id="probe">(.*?)</pre>', done.stdout, re.DOTALL)
    assert found
    seen = json.loads(found[1])
    assert seen["pictures"] > 8
    assert seen["broken"] == []
    assert seen["page"] <= seen["window"]
    assert seen["small"] == 0
    assert [line for line in done.stderr.splitlines() if "CONSOLE" in line] == []


@pytest.mark.parametrize("width", [390, 1280])
def test_screenshot_is_not_empty(browser: str, small_report: Path, width: int) -> None:
    """A screenshot has the size of the screen and shows more than a plain colour."""
    picture = small_report.with_name(f"screen-{width}.png")
    run_browser(browser, small_report, width, f"--screenshot={picture}")
    content = picture.read_bytes()
    assert struct.unpack(">II", content[16:24]) == (width, 2400)
    start = content.index(b"IDAT") + 4
    length = int.from_bytes(content[start - 8 : start - 4], "big")
    pixels = zlib.decompressobj().decompress(content[start : start + length])
    assert len(set(pixels)) > 50
