"""Fitting: physical parameters and networks from recordings."""
