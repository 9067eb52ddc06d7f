"""The turbine valve servo of [L18]: its identification, its networks, its primary control."""
