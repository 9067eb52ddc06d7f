"""What holds for every test."""
import os

from hypothesis import settings

# No test is timed; and the small matrices here gain nothing from threads of BLAS.
settings.register_profile('untimed', deadline=None)
settings.load_profile('untimed')
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
os.environ.setdefault('OMP_NUM_THREADS', '1')
