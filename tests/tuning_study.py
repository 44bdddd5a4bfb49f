"""What the tests of tuning share: a small study that compiles in seconds."""

from pathlib import Path

import memsgyro_jax as mg


STUDY = """
schema = "memsgyro-study/1"

[readout]
kind = "displacement"
scale = "1e5 V/m"
noise_density = "20 nV/sqrt(Hz)"

[observer]
kind = "ekf"
known = ["kxx", "kyy", "kxy", "dxx", "dyy", "dxy", "sigma"]
with_offsets = false
discretisation = "euler"
noise_density = "60 nV/sqrt(Hz)"        # three times too much
process_noise = { rate = "1e5 rad^2/s^3" }  # a hundredth of the truth

[controller]
kind = "open_loop"

[filter]
kind = "lowpass"
bandwidth = "300 Hz"
order = 1

[loop]
discretisation = "euler"

[scenario]
rate = { kind = "random_walk", intensity = "1e7 rad^2/s^3", duration = "2 ms", rows = 1000 }  # one for each sample

[spread.parameters]
"scenario.rate.realisation" = { kind = "uniform", low = "0", high = "1" }
"start.0" = { kind = "normal" }

[sweep]
dies = 16
sample_rate = "500 kHz"
duration = "2 ms"

[tune]
free = [
    "observer.noise_density",
    { path = "observer.process_noise.rate", low = "1 rad^2/s^3", high = "1e9 rad^2/s^3" },
    { path = "filter.bandwidth", low = "10 Hz", high = "200 kHz" },
]
dies = 16
validation_dies = 8
"""


def small_study(folder: Path) -> mg.Study:
    """The study, read from a file in `folder`."""
    path = folder / "small.toml"
    path.write_text(STUDY)
    return mg.load_study(path)
