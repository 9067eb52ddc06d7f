"""A model: its value, effects at its ports by name, and its file."""
from hydro_twin.model.file import document, load_predictor, read_model, write_model
from hydro_twin.model.placing import place
from hydro_twin.model.value import Estimate, Model, Noise, Record, Uncertainty

__all__ = ['Estimate', 'Model', 'Noise', 'Record', 'Uncertainty', 'document', 'load_predictor',
           'place', 'read_model', 'write_model']
