"""The residual: is anything left, what is it, and is that certain."""
