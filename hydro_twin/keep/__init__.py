"""Keeps a model up to date, without ROS: capture, trace, judge, promote, roll back."""
