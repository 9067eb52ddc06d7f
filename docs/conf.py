"""Sphinx: these pages, and a reference made of the docstrings (`make docs`)."""
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as version_of

project = 'hydro_twin'
try:
    version = release = version_of('hydro_twin')
except PackageNotFoundError:      # under rosdoc2, which need not install the package
    version = release = ''
extensions = ['myst_parser', 'sphinx.ext.apidoc', 'sphinx.ext.autodoc', 'sphinx.ext.napoleon',
              'sphinx.ext.viewcode']
apidoc_modules = [{'path': '../hydro_twin', 'destination': 'reference', 'separate_modules': True,
                   'exclude_patterns': ['../hydro_twin/studies/**']}]
autodoc_typehints = 'description'
autodoc_default_options = {'members': True, 'show-inheritance': True,
                           'ignore-module-all': True}      # each name where it is defined
napoleon_use_ivar = True
autodoc_mock_imports = [   # what a build need not have installed: ROS, and torch
    'builtin_interfaces', 'diagnostic_msgs', 'lifecycle_msgs', 'rcl_interfaces', 'rclpy',
    'rosgraph_msgs', 'sensor_msgs', 'std_msgs', 'std_srvs', 'torch',
]
myst_heading_anchors = 4
suppress_warnings = [   # links out of these pages, drawings, names that two modules have, and
    # equations that are indented in a docstring
    'myst.xref_missing', 'misc.highlighting_failure', 'ref.python', 'docutils',
]
exclude_patterns = ['_build']
html_title = 'hydro_twin'


def setup(app):
    """Take |x| and * in docstrings as the mathematics that they are."""
    def escape(app, what, name, obj, options, lines):
        lines[:] = [line.replace('|', r'\|').replace('*', r'\*') for line in lines]

    app.connect('autodoc-process-docstring', escape)
