"""The loop that keeps a model true, without ROS: capture, trace, judge, promote, go back."""
