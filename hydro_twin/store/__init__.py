"""The models of one rig over its life: versions in a folder, which of them runs, and why."""
