"""Reproductions of published studies; the core does not import them."""
