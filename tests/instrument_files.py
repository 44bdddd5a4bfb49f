"""One frequency sweep of a resonator as different instruments would save it."""

import re

import h5py
import nptdms
import numpy as np
import pyuff
import skrf
from scipy.io import netcdf_file, savemat


FREQUENCY = np.round(np.linspace(3900.0, 4100.0, 41), 3)
RESPONSE = 1.6e-3 / ((1.0 - (FREQUENCY / 4000.0) ** 2) * 80.0 + 1j * FREQUENCY / 4000.0)  # displacement, Q 80
PEAK = 2.0**0.5


def semicolons(path, mark=",", delimiter=";", end="\r\n", encoding="utf-8", top=("% a lock-in", "% gain: 10")):
    rows = [f"{f:.3f}{delimiter}{z.real:.9e}{delimiter}{z.imag:.9e}" for f, z in zip(FREQUENCY, RESPONSE, strict=True)]
    head = delimiter.join(("Frequency (Hz)", "X (V)", "Y (V)"))
    text = end.join([*top, head, *(row.replace(".", mark) for row in rows)]) + end
    path.write_bytes(text.encode(encoding))


def labone_rows(path):
    fields = {"grid": FREQUENCY, "x": RESPONSE.real / PEAK, "y": RESPONSE.imag / PEAK, "bandwidth": 0 * FREQUENCY + 10}
    lines = ["chunk;timestamp;size;fieldname;" + ";".join(f"v{n}" for n in range(len(FREQUENCY)))]
    lines += [f"0;12345;{len(v)};{k};" + ";".join(f"{x:.12g}" for x in v) for k, v in fields.items()]
    path.write_text("\n".join(lines) + "\n")


def labone_columns(path):
    lines = ["chunk;timestamp;x;y;freq;phase;dio;trigger;auxin0;auxin1"]
    rows = enumerate(zip(RESPONSE / PEAK, FREQUENCY, strict=True))
    lines += [f"0;{1000 + 7 * n};{z.real:.12g};{z.imag:.12g};{f:.6f};{n % 6:.3f};0;0;0;0" for n, (z, f) in rows]
    path.write_text("\n".join(lines) + "\n")


def labone_hdf5(path):
    with h5py.File(path, "w") as file:
        sample = file.create_group("000/dev1234/demods/0/sample")
        sample["frequency"], sample["x"], sample["y"] = FREQUENCY, RESPONSE.real / PEAK, RESPONSE.imag / PEAK
        sample["timestamp"] = np.arange(len(FREQUENCY), dtype=np.uint64) * 1000
        header = sample.create_group("chunkheader")
        header["timebase"] = np.array([1e-6])


def labone_mat(path):
    sample = {"frequency": FREQUENCY, "x": RESPONSE.real / PEAK, "y": RESPONSE.imag / PEAK, "settling": 0 * FREQUENCY}
    cell = np.empty((1, 1), object)
    cell[0, 0] = sample
    savemat(path, {"dev1234": {"demods": {"sample": cell}}})


def plain_mat(path):
    savemat(path, {"f_Hz": FREQUENCY, "H": RESPONSE, "comment": "a note"})


def plain_hdf5(path):
    with h5py.File(path, "w") as file:
        file["frequency"], file["X"], file["Y"] = FREQUENCY, RESPONSE.real * 1e3, RESPONSE.imag * 1e3
        file["X"].attrs["units"] = file["Y"].attrs["units"] = "mV"


def netcdf(path):
    with netcdf_file(path, "w") as file:
        file.createDimension("f", len(FREQUENCY))
        parts = (("frequency", "kHz", FREQUENCY / 1e3), ("real", "V", RESPONSE.real), ("imag", "V", RESPONSE.imag))
        for name, unit, values in parts:
            variable = file.createVariable(name, "d", ("f",))
            variable[:], variable.units = values, unit


def tdms(path):
    with nptdms.TdmsWriter(str(path)) as writer:
        parts = {"Frequency": (FREQUENCY, "Hz"), "X": (RESPONSE.real, "V"), "Y": (RESPONSE.imag, "V")}
        writer.write_segment([nptdms.ChannelObject("sweep", k, v, {"unit_string": u}) for k, (v, u) in parts.items()])


def universal(path):
    pyuff.UFF(str(path)).write_sets(
        {
            "type": 58, "func_type": 4, "rsp_node": 1, "rsp_dir": 3, "ref_dir": 3, "ref_node": 1, "data": RESPONSE,
            "x": FREQUENCY, "id1": "a sweep", "rsp_ent_name": "", "ref_ent_name": "", "abscissa_spacing": 1,
            "abscissa_spec_data_type": 18, "ordinate_spec_data_type": 8, "orddenom_spec_data_type": 13,
            "ordinate_axis_units_lab": "V", "binary": 0,
        },
        "overwrite",
    )  # fmt: skip


def labview_text(path, mark=","):
    top = f"""LabVIEW Measurement|Writer_Version 2|Reader_Version 2|Separator Tab|Decimal_Separator {mark}
Multi_Headings No|X_Columns One|Time_Pref Relative|Operator lab|Date 2024/05/06|Time 10:11:12,5
***End_of_Header*** ||Channels 2  |Samples 41 41 |Y_Unit_Label Volts Volts |X_Dimension Frequency Frequency
X0 3,9E+3 3,9E+3|Delta_X 5,0 5,0|***End_of_Header***   |X_Value Real Imaginary Comment"""
    top = [line.replace(" ", "\t") for line in re.split(r"[|\n]", top)]
    top[0] = "LabVIEW Measurement"
    rows = [f"{f:.6f}\t{z.real:.9e}\t{z.imag:.9e}\t" for f, z in zip(FREQUENCY, RESPONSE, strict=True)]
    path.write_bytes("\r\n".join([*top, *(row.replace(".", mark) for row in rows)]).encode() + b"\r\n")


def touchstone(path):
    scattering = np.zeros((len(FREQUENCY), 2, 2), complex)
    scattering[:, 0, 1] = scattering[:, 1, 0] = RESPONSE
    scattering[:, 0, 0] = scattering[:, 1, 1] = 1 - RESPONSE
    network = skrf.Network(f=FREQUENCY, f_unit="hz", s=scattering, z0=50.0)
    network.write_touchstone(path.stem, str(path.parent), form="ri")


def labone_sweeps(path, gain, noise):
    """Two chunks of the sweeper, up and down, with noise of its own in each."""
    random = np.random.default_rng(int(10 * gain))
    lines = ["chunk;timestamp;size;fieldname;values"]
    for chunk, order in enumerate((slice(None), slice(None, None, -1))):
        z = (gain * RESPONSE[order] + noise * (random.normal(size=(2, 41)).T @ [1, 1j])) / PEAK
        fields = {"frequency": FREQUENCY[order], "x": z.real, "y": z.imag, "tc": 0.01 + 0 * z.real}
        lines += [f"{chunk};{chunk + 5};41;{key};" + ";".join(f"{x:.9g}" for x in v) for key, v in fields.items()]
    path.write_text("\n".join(lines) + "\n")
