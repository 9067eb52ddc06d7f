"""The predictors: one file a kind, found by being in this folder, or by an entry point."""
from hydro_twin.predictors.kind import Kind
from hydro_twin.predictors.predictor import MODES, modes_of, OBSERVER, Predictor, Stepper
from hydro_twin.predictors.registry import kind_named, kinds, make_predictor

__all__ = ['MODES', 'OBSERVER', 'Kind', 'Predictor', 'Stepper', 'kind_named', 'kinds',
           'make_predictor', 'modes_of']
