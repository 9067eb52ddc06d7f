"""Inference from the residual: whether it has structure, which effects explain it, how surely."""
