"""The shell of ROS 2 round the live twin: node, topics, parameters, player of bags."""
