"""A digital twin of electro-hydraulic actuators: live beside the rig, and offline on bags."""
