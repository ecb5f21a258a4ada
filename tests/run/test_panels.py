"""Pictures in a row, as a wipe, and as their difference."""

from __future__ import annotations

import numpy as np

from tnst_mi.run.panels import difference, on_canvas, row, wipe


def test_a_wipe_has_the_left_of_one_and_the_right_of_the_other() -> None:
    a, b = np.full((500, 41), 0.25), np.full((500, 41), 0.75)
    joined = wipe(a, b)
    assert joined.shape == (500, 43, 3)
    np.testing.assert_array_equal(joined[7, :, 1], [0.25] * 20 + [1.0] * 2 + [0.75] * 21)


def test_a_difference_shows_which_is_brighter() -> None:
    a, b = np.array([[0.2, 0.5, 0.5]]), np.array([[0.7, 0.5, 0.25]])
    brighter, same, darker = difference(a, b, 2.0)[0]
    np.testing.assert_allclose(brighter, [1.0, 0.55, 0.1])
    np.testing.assert_allclose(same, 0.0)
    np.testing.assert_allclose(darker, [0.075, 0.25, 0.5])


def test_a_row_keeps_pictures_and_enlarges_small_ones() -> None:
    grey, colour = np.full((500, 30), 0.2), np.full((500, 40, 3), (0.4, 0.6, 0.8))
    sheet = row([("grey", grey), ("a name that is much too long for its picture", colour)])
    top = sheet.shape[0] - 500
    assert top > 0 and sheet.shape[1] == 30 + 5 + 40
    np.testing.assert_allclose(sheet[top:, :30], 51 / 255, atol=1e-6)
    np.testing.assert_allclose(sheet[top:, 35:], np.broadcast_to([102, 153, 204], (500, 40, 3)) / 255, atol=1e-6)
    assert sheet[top:, 30:35].max() == 0.0 and sheet[:top].max() > 0.5
    small = row([("a", grey[:6, :5])])
    assert small.shape[1] == 5 * 67 and small.shape[0] > 6 * 67
    # Names do not run into the next picture.
    assert row([("m" * 90, grey), ("", grey)])[:top, 30:].max() < 0.2


def test_a_canvas_is_around_the_middle() -> None:
    placed = on_canvas(np.ones((2, 3)), 5, 6)
    assert placed.shape == (5, 6) and placed.sum() == 6 and placed[1:3, 1:4].all()
