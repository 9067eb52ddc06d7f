"""What is special to the turbine valve servo of [L18]: its identification, curve and control."""
