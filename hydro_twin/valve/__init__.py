"""What is special to the turbine valve servo: its flow characteristic, and its end of travel."""
