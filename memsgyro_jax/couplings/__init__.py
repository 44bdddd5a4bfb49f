"""Coupling errors from frequency sweeps: two modes in closed form, their likelihood, and the published ratio."""
