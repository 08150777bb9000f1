"""Records refuse what is no result, and compare by value."""

import dataclasses
import io
import pickle
from collections.abc import Callable
from datetime import datetime
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calcidem.ends import CellStatus
from calcidem.storage.records import (
    CellKey,
    CellResult,
    CementPattern,
    PathFeatures,
    RecordedSection,
    canonical_content,
    canonical_hash,
    canonical_json,
    config_difference,
    pack_arrays,
    unpack_arrays,
)

if TYPE_CHECKING:
    from conftest import Records


def section(**changes: Any) -> RecordedSection:  # noqa: ANN401
    """Two samples of one station and of the receiver."""
    values: dict[str, Any] = {
        "sampling_interval": 1e-6,
        "start_time": 4e-7,
        "pulse_frequency": 1e4,
        "resolution": 1e-3 / 2**20,
        "places": [0.04, 0.09],
        "across": [[1, 2], [3, 4]],
        "along": [[0, 0], [0, 1]],
    }
    return RecordedSection(**(values | changes))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"vs": None}, "lacks vs"),
        ({"vs": float("nan")}, "vs is nan"),
        ({"vs": np.float64("inf")}, "vs is inf"),
        ({"vs": -1.0}, "vs is -1"),
        ({"vs": 0.0}, "vs is 0"),
        ({"vs_peak": float("nan")}, "vs_peak is nan"),
        ({"time_step": None}, "lacks time_step"),
        ({"steps": -1}, "steps is -1"),
        ({"attempt": 0}, "attempt is 0; give a positive number"),
        ({"status": "failed"}, "only a done cell"),
        ({"status": "failed", "vs": None}, "say why"),
        ({"status": "pending", "vs": None}, "an outcome is one of"),
        ({"status": "splendid"}, "splendid"),
    ],
)
def test_contradictory_results_are_refused(records: "Records", changes: dict[str, Any], message: str) -> None:
    """A result whose numbers contradict its status can't be built, and the message names the field."""
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(records.done(), **changes)


def test_a_record_is_a_table_in_a_notebook() -> None:
    """It has each known quantity with unit and meaning, text that cannot be markup, and the names of its arrays."""
    failed = CellResult(CellKey(7, 5.0), CellStatus.NO_ARRIVAL, "<b>too weak</b>", frequency=8e3)
    page = failed._repr_html_()
    assert "<td>frequency</td><td>8000 Hz</td><td>frequency of the transmitted pulse</td>" in page
    assert "<td>content</td><td>5 percent</td>" in page
    assert "<td>&lt;b&gt;too weak&lt;/b&gt;</td>" in page
    assert "<td>vs</td>" not in page
    assert "arrays" not in page


def test_a_reason_that_is_no_text_is_one_of_a_damaged_database(records: "Records") -> None:
    """A bit that changed may make it NULL; the error is one that a store tells as damage."""
    with pytest.raises(TypeError):
        dataclasses.replace(records.done(7, 5.0), reason=None)  # type: ignore[arg-type]  # as read


@given(st.floats(0.0, 100.0), st.floats(-4e-10, 4e-10))
def test_near_contents_are_one_key(content: float, noise: float) -> None:
    """Contents rounded to nine decimals keep their key under any noise below half of the last decimal."""
    rounded = round(content, 9)
    noisy = min(max(rounded + noise, 0.0), 100.0)
    assert canonical_content(noisy) == canonical_content(rounded)
    assert canonical_content(canonical_content(content)) == canonical_content(content)


@pytest.mark.parametrize("content", [-0.1, 100.1, float("nan"), float("inf")])
def test_impossible_contents_are_refused(content: float) -> None:
    """Contents outside of 0 to 100 % are refused."""
    with pytest.raises(ValueError, match="between 0 and 100"):
        CellKey(0, content)


def test_negative_zero_is_zero() -> None:
    """Minus zero percent is written as zero, so that it doesn't show in texts."""
    assert str(CellKey(0, -0.0).content) == "0.0"


def test_negative_seed_is_refused() -> None:
    """Seeds are 0 or more."""
    with pytest.raises(ValueError, match="seed is -1"):
        CellKey(-1, 0.0)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: section(along=[[1, 2]]), "along has shape"),
        (lambda: section(across=[[1], [2]]), "across has shape"),
        (lambda: section(sampling_interval=0.0), "sampling_interval"),
        (lambda: section(resolution=-1.0), "resolution"),
        (lambda: section(places=[np.nan, 0.09]), "places holds NaN"),
        (lambda: CementPattern([[1, 2]], [3], np.zeros((0, 2))), "kind"),
        (lambda: CementPattern([1, 2], [1], np.zeros((0, 2))), "contacts has shape"),
        (lambda: CementPattern([[1, 2.5]], [1], np.zeros((0, 2))), "can't represent"),
        (lambda: PathFeatures(3, 1, 1, 0.5, 0.5, 1, 2.0, 1.0), "must add up"),
    ],
)
def test_wrong_arrays_are_refused(build: Callable[[], object], message: str) -> None:
    """Arrays of wrong shape, type or content are refused with the field's name."""
    with pytest.raises(ValueError, match=message):
        build()


def test_records_with_arrays_compare_by_value(records: "Records") -> None:
    """Equal content is equal, one other element is not, and other types never are."""
    cement = records.with_arrays().cement
    other = dataclasses.replace(cement, cluster_centres=cement.cluster_centres + 1e-12)
    assert cement == dataclasses.replace(cement)
    assert cement != other
    assert cement != "cement"


def test_arrays_of_records_are_frozen_copies() -> None:
    """Changing the caller's array doesn't change a record, and a record's array can't be written."""
    counts = np.array([[1, 2], [3, 4]], dtype=np.int32)
    recorded = section(across=counts, along=counts)
    counts[0, 0] = 9
    assert recorded.across[0, 0] == 1
    with pytest.raises(ValueError, match="read-only"):
        recorded.across[0, 0] = 9


def test_a_section_gives_times_and_velocities() -> None:
    """What is not stored of it follows from what is: times, the pulse, and what the receiver recorded."""
    recorded = section()
    np.testing.assert_array_equal(recorded.time, [4e-7, 4e-7 + 1e-6])
    np.testing.assert_allclose(recorded.transmitted, 1e-3 * (1.0 - np.cos(2e4 * np.pi * recorded.time)), rtol=1e-12)
    np.testing.assert_allclose(recorded.received, np.array([2, 4]) * 1e-3 / 2**20, rtol=1e-15)
    assert section(start_time=1.1e-4).transmitted.tolist() == [0.0, 0.0]


def test_results_travel_between_processes(records: "Records") -> None:
    """A result with arrays survives pickling, as between MPI ranks."""
    result = records.with_arrays()
    assert pickle.loads(pickle.dumps(result)) == result  # noqa: S301 - own data


def test_numpy_scalars_become_plain_numbers(records: "Records") -> None:
    """NumPy scalars are taken and turned into Python's numbers, which database drivers know."""
    result = records.done(np.int64(3), np.float64(5.0), vs=np.float64(7.0), steps=np.int32(5))
    assert [type(v) for v in (result.key.seed, result.key.content, result.vs, result.steps)] == [int, float, float, int]


def test_moments_need_a_time_zone(records: "Records") -> None:
    """A moment without time zone is refused."""
    with pytest.raises(ValueError, match="time zone"):
        records.campaign(created=datetime(2024, 1, 1))  # noqa: DTZ001 - the point of the test


def test_hash_depends_on_content_only() -> None:
    """The hash is the same for any order of keys and differs for any other value."""
    assert canonical_hash({"a": 1, "b": {"c": 0.1, "d": 2}}) == canonical_hash({"b": {"d": 2, "c": 0.1}, "a": 1})
    assert canonical_hash({"a": 0.1}) != canonical_hash({"a": 0.1 + 2e-17 + 1e-16})
    with pytest.raises(ValueError, match="JSON"):
        canonical_json({"a": float("nan")})


def test_difference_names_nested_keys() -> None:
    """The difference lists changed, added and removed keys with their path, and nothing else."""
    before = canonical_json({"packing": {"friction": 0.2, "steps": [1, 2]}, "same": {"x": None}, "gone": 1})
    after = canonical_json({"packing": {"friction": 0.5, "steps": [1, 3]}, "same": {"x": None}, "new": {}})
    assert config_difference(before, after) == [
        "gone: 1 -> (not there)",
        "new: (not there) -> {}",
        "packing.friction: 0.2 -> 0.5",
        "packing.steps: [1, 2] -> [1, 3]",
    ]


def test_status_values_are_words() -> None:
    """Statuses are their own words, as they are stored and typed by users."""
    assert [str(status) for status in CellStatus][2:4] == ["done", "no_arrival"]
    assert CellResult.__dataclass_params__.frozen


def test_blobs_of_any_compression_are_read() -> None:
    """Arrays packed here, and those that NumPy's own function packed, as earlier versions did, are read to the bit."""
    arrays = {
        "pairs": np.arange(600, dtype=np.int32).reshape(300, 2),
        "empty": np.empty((0, 2)),
        "pi": np.full(9, np.pi),
    }
    former = io.BytesIO()
    np.savez_compressed(former, **arrays)
    for blob in (pack_arrays(arrays), former.getvalue()):
        read = unpack_arrays(blob)
        assert list(read) == list(arrays)
        assert all(read[name].dtype == arrays[name].dtype for name in arrays)
        assert all(np.array_equal(read[name], arrays[name]) for name in arrays)
    assert pack_arrays(arrays) == pack_arrays(arrays)
    assert np.load(io.BytesIO(pack_arrays(arrays)))["pi"][0] == np.pi
