import pytest

from calcidem.wording import duration


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (None, "?"),
        (0.4, "0 s"),
        (99.0, "99 s"),
        (300.0, "5 min"),
        (3 * 3600.0 + 120.0, "3 h 02 min"),
        (50 * 3600.0, "2 d 2 h"),
    ],
)
def test_durations_read_well(seconds: float | None, text: str) -> None:
    """A duration is given in the two largest units that matter."""
    assert duration(seconds) == text
