"""Strengths of every hidden effect: well above the noise of a full case, and the motion stays single-valued."""

from lab.die import Hidden, Outside


VISIBLE = {
    "cubic_stiffness_x": 2e9,
    "cubic_stiffness_y": 2e9,
    "quadratic_stiffness_x": 3e4,
    "quadratic_stiffness_y": 3e4,
    "cross_stiffness": 2e10,
    "electrostatic_softening_x": 2e-4,
    "electrostatic_softening_y": 2e-4,
    "electrostatic_cubic_stiffness_x": 2e7,
    "electrostatic_cubic_stiffness_y": 2e7,
    "bias_transduction_drive": 0.02,
    "bias_transduction_pickoff": 0.02,
    "cross_damping_asymmetry": 2.4e-7,
    "quadratic_damping_x": 2e-5,
    "quadratic_damping_y": 2e-5,
    "squeeze_film_damping_x": 2e5,
    "squeeze_film_damping_y": 2e5,
    "dry_friction_x": 1e-9,
    "dry_friction_y": 1e-9,
    "thermal_drift_stiffness": -6e-5,
    "thermal_drift_damping": 3e-3,
    "thermal_curvature_stiffness": 5e-7,
    "thermal_curvature_damping": 1e-4,
    "rate_offset": 0.2,
    "rate_scale_error": 0.03,
    "angular_acceleration": 20.0,
    "centrifugal": 2000.0,
    "damping_step": 0.1,
    "parasitic_mode_x": 1e-4,
    "parasitic_mode_y": 1e-4,
    "force_misalignment_x_to_y": 0.02,
    "force_misalignment_y_to_x": 0.02,
    "drive_nonlinearity_x": 2e4,
    "drive_nonlinearity_y": 2e4,
    "electrical_feedthrough_x_to_x": 4e3,
    "electrical_feedthrough_x_to_y": 4e3,
    "electrical_feedthrough_y_to_x": 4e3,
    "electrical_feedthrough_y_to_y": 4e3,
    "readout_delay": 3.5e-7,
    "pickoff_scale_error_x": 0.02,
    "pickoff_scale_error_y": 0.02,
    "pickoff_nonlinearity_x": 2e4,
    "pickoff_nonlinearity_y": 2e4,
    "pickoff_cubic_nonlinearity_x": 1e10,
    "pickoff_cubic_nonlinearity_y": 1e10,
    "pickoff_crosstalk_x_to_y": 0.01,
    "pickoff_crosstalk_y_to_x": 0.01,
    "adc_saturation": 1.25,
    "finite_sweep_rate": 0.5,
}

OUTSIDE = {
    "bouc_wen_x": 0.02,
    "bouc_wen_y": 0.02,
    "stop_x": 2.0,
    "stop_y": 2.0,
    "maxwell_x": 0.1,
    "maxwell_y": 0.1,
    "drive_heating_x": 0.02,
    "drive_heating_y": 0.02,
    "pickoff_compression_x": 0.02,
    "pickoff_compression_y": 0.02,
}


def visible(*names, times=1.0):
    """These effects together, each at its visible strength times a factor: names of both tables, `rate_bias_drift`."""
    catalogue = {n: times * VISIBLE[n] for n in names if n in VISIBLE}
    outside = Outside(**{n: times * OUTSIDE[n] for n in names if n in OUTSIDE})
    if "damping_step" in catalogue:
        catalogue["damping_step_time"] = 0.155
    if "rate_bias_drift" in names:
        catalogue["rate_bias_drift"] = (0.05 * times, 0.03 * times)
    return Hidden(**catalogue, outside=outside)
