"""The ROS 2 interface of the live twin: node, topics, parameters, player of bags."""
