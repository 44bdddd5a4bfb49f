"""Rate logs as loggers write them are read as plain ones are, which are still read to the letter."""

import numpy as np
import pytest

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.measurement.log_table import log_table
from memsgyro_jax.measurement.rate_log import read_rate_log


RATE = np.random.default_rng(0).normal(size=60)
STAMPS = [f"2026-11-20T10:00:{k // 10:02d}.{k % 10}00" for k in range(60)]


@pytest.mark.parametrize(
    ("head", "row"),
    [
        ("timestamp;rate (deg/s);temperature (C)", lambda k: f"{STAMPS[k]};{RATE[k]:.9f};25.0"),
        ("Time (s)\tRate (deg/s)", lambda k: f"{k / 10:.1f}\t{RATE[k]:.9f}".replace(".", ",")),
        ("Time (s),Gyro Z (deg/s)", lambda k: f"{k / 10:.1f},{RATE[k]:.9f}"),
        ("time [s],rate [deg/s]", lambda k: f"{k / 10:.1f},{RATE[k]:.9f}"),
    ],
    ids=["dates", "decimal commas", "brackets", "plain"],
)
def test_a_logger_writes_as_it_likes(head, row, tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("\n".join([head, *map(row, range(60))]) + "\n")
    log = read_rate_log(path)
    assert log.period == pytest.approx(0.1, rel=1e-9)
    np.testing.assert_allclose(np.degrees(log.rate[0]), RATE, atol=1e-8)


def test_what_is_no_number_is_refused_in_both(tmp_path):
    for head, mark in (("time [s],rate [deg/s]", ","), ("time (s);rate (deg/s)", ";")):
        rows = [f"{k / 10:.1f}{mark}{'nan' if k == 7 else RATE[k]}" for k in range(60)]
        (tmp_path / "log.csv").write_text("\n".join([head, *rows]) + "\n")
        with pytest.raises(InputError, match=r"rate.*number"):
            log_table(tmp_path / "log.csv")


def test_the_unit_of_a_rate_may_be_said_where_the_file_names_none(tmp_path):
    """As an inertial module exports its packets."""
    path = tmp_path / "imu.csv"
    rows = [f"{k + 65000},{np.radians(RATE[k]):.12f},0.0" for k in range(60)]
    path.write_text("\n".join(["PacketCounter,Gyr_X,Gyr_Y", *rows]) + "\n")
    with pytest.raises(InputError, match=r'say its unit: `--column "Gyr_X \[deg/s\]"`'):
        read_rate_log(path, 100.0)
    log = read_rate_log(path, 100.0, "Gyr_X [rad/s]")
    np.testing.assert_allclose(np.degrees(log.rate), [RATE], atol=1e-9)
    assert log.names == ("Gyr_X",)
    with pytest.raises(InputError, match="must have a column such as"):
        read_rate_log(path, 100.0, "Gyr_Z [rad/s]")
