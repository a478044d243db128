"""When scans were taken: stamps, seconds, the nominal rate."""

import numpy as np
import pytest

from tests.kitti_folder import seconds, stamp, write
from tracker.errors import DataError
from tracker.kitti.clock import nominal_times, read_times


def read(tmp_path, *lines):
    return read_times(write(tmp_path / "times.txt", "".join(f"{line}\n" for line in lines)))


def test_stamps_are_seconds_since_the_midnight_before_the_first(tmp_path):
    times = read(tmp_path, *(stamp(k) for k in range(12)))
    np.testing.assert_allclose(times, [seconds(k) for k in range(12)], rtol=0, atol=1e-10)


def test_stamps_keep_their_nanoseconds(tmp_path):
    times = read(tmp_path, "2011-09-26 23:04:32.335337762", "2011-09-26 23:04:32.335337792")
    assert times[1] - times[0] == pytest.approx(30e-9, abs=2e-11)


def test_time_goes_on_over_midnight_and_over_the_end_of_a_leap_february(tmp_path):
    times = read(tmp_path, "2012-02-28 23:59:59.75", "2012-02-29 00:00:00.25", "2012-03-01 00:00:00")
    np.testing.assert_array_equal(times, [86399.75, 86400.25, 2 * 86400.0])


def test_a_stamp_needs_no_fraction(tmp_path):
    assert read(tmp_path, "2011-09-26 00:01:00").tolist() == [60.0]


def test_plain_seconds_are_taken_as_they_are(tmp_path):
    np.testing.assert_array_equal(read(tmp_path, "0.0", "0.125", "1e1"), [0.0, 0.125, 10.0])


def test_seconds_of_an_epoch_count_from_that_days_midnight(tmp_path):
    midnight = 15243 * 86400
    np.testing.assert_allclose(read(tmp_path, f"{midnight + 7}.25", f"{midnight + 7}.5"), [7.25, 7.5], atol=1e-6)


def test_blank_lines_at_the_end_are_no_times(tmp_path):
    assert len(read(tmp_path, "0.0", "0.1", "", "  ", "")) == 2


def test_a_blank_line_between_times_is_refused_because_the_next_would_move_up_a_frame(tmp_path):
    with pytest.raises(DataError, match=r"times\.txt:2: expected a timestamp .*, got ''"):
        read(tmp_path, stamp(0), "", stamp(2))


@pytest.mark.parametrize("later", [stamp(0), stamp(1)])
def test_time_that_stands_still_or_goes_back_is_refused_with_both_lines(tmp_path, later):
    with pytest.raises(DataError, match=r"times\.txt:3: expected a later time than in line 2, got '.*' after '.*'"):
        read(tmp_path, stamp(0), stamp(1), later, stamp(5))


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("noon", r"expected a timestamp \(.*\), got 'noon'"),
        ("2011-13-26 13:02:25.1", r"expected a date and a time, got '2011-13-26 13:02:25\.1'"),
        ("2011-09-26 13:02:25.1 UTC", r"expected a timestamp"),
        ("nan", r"expected a finite time, got 'nan'"),
    ],
)
def test_a_line_that_is_no_time_is_refused_with_file_and_line(tmp_path, line, message):
    with pytest.raises(DataError, match=rf"times\.txt:2: {message}"):
        read(tmp_path, "2011-09-26 13:02:25.0", line)


@pytest.mark.parametrize("lines", [[], ["", " "]])
def test_a_file_without_times_is_refused(tmp_path, lines):
    with pytest.raises(DataError, match=r"times\.txt: expected one timestamp a line, got an empty file"):
        read(tmp_path, *lines)


def test_the_nominal_rate_is_ten_sweeps_a_second():
    np.testing.assert_allclose(nominal_times(4), [0.0, 0.1, 0.2, 0.3])
    assert nominal_times(0).shape == (0,)
