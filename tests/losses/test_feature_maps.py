"""Files with maps of features: what is read, and every refusal in one line."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from tnst_mi.errors import InputError
from tnst_mi.losses import feature_maps
from tnst_mi.losses.feature_maps import read_map

MAP = np.arange(24, dtype=np.float64).reshape(2, 3, 4)


@pytest.mark.parametrize("arrays", [{"anything": MAP}, {"map": MAP, "other": np.zeros(3)}])
def test_a_map_is_the_only_array_or_the_one_of_that_name(arrays: dict[str, np.ndarray], tmp_path: Path) -> None:
    np.savez(tmp_path / "m.npz", **arrays)
    found = read_map(tmp_path / "m.npz")
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, MAP)


@pytest.mark.parametrize(
    ("arrays", "complaint"),
    [
        ({"a": MAP, "b": MAP}, "m.npz: holds a, b, expected an array 'map'"),
        ({}, "m.npz: holds nothing, expected an array 'map'"),
        (
            {"map": MAP[None]},
            r"array 'map' has shape \(1, 2, 3, 4\), expected a map \(C, H, W\) of 1 to 67108864 values",
        ),
        ({"map": MAP[:, :0]}, r"array 'map' has shape \(2, 0, 4\), expected"),
        ({"map": np.array([1.0, np.nan, np.inf])}, "2 of 3 values of array 'map' are not finite"),
        ({"map": np.array(["a", "b"])}, "expected numbers"),
        ({"map": np.array([{}])}, "pickled"),
    ],
)
def test_bad_files_are_refused_in_one_line(arrays: dict[str, np.ndarray], complaint: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "m.npz", allow_pickle=True, **arrays)
    with pytest.raises(InputError, match=complaint) as error:
        read_map(tmp_path / "m.npz")
    assert "\n" not in str(error.value)


def test_what_is_no_npz_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "m.npz").write_bytes(b"nothing of the kind")
    with pytest.raises(InputError, match=re.escape(f"{tmp_path / 'm.npz'}: not an npz file")):
        read_map(tmp_path / "m.npz")
    with pytest.raises(InputError, match="no such file"):
        read_map(tmp_path / "nowhere.npz")


def test_the_size_is_checked_before_anything_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    np.savez(tmp_path / "m.npz", map=MAP)
    monkeypatch.setattr(feature_maps, "LARGEST_MAP", 23)
    monkeypatch.setattr(feature_maps, "read_arrays", lambda *_: pytest.fail("was read"))
    with pytest.raises(InputError, match="of 1 to 23 values"):
        read_map(tmp_path / "m.npz")
