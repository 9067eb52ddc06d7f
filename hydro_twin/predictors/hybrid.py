"""The hybrid of [B19]: a network gives what the physics lacks in one step."""
from __future__ import annotations

from hydro_twin.predictors.kind import Kind, Settings
from hydro_twin.predictors.network_predictor import load_network_predictor

HYBRID = Kind('hybrid', 'a hybrid', load_network_predictor,
              network=Settings(hidden=(80,), decay=0.0))    # by the text; Table 3 has 2 layers
