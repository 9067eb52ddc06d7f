"""The live twin without ROS: messages to samples, samples to predictions, does the model hold."""
