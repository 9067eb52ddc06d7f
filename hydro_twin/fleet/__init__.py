"""Many rigs: their traces on an engine, the mean of each group, and one page of all."""
from hydro_twin.fleet.run import trace_fleet

__all__ = ['trace_fleet']
