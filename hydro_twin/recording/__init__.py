"""Recordings: bags and tables in, uniform columns out, and back into a bag."""
