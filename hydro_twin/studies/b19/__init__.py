"""The study of [B19]: optimisers, networks and hybrids of a load simulator."""
