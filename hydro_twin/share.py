"""Where the files that come with the package are: config/, launch/ and bags/."""
from __future__ import annotations

from pathlib import Path

from hydro_twin.errors import UserError


def share_folder() -> Path:
    """Return the folder that holds config/, launch/ and bags/.

    That is the source tree where the package runs from one (an editable install, a symlinked
    workspace), else `share/hydro_twin` under the prefix that the package is installed in.

    Raises:
        UserError: the package was installed without them.
    """
    here = Path(__file__).resolve()
    if (here.parents[1] / 'package.xml').is_file():
        return here.parents[1]
    for prefix in here.parents:
        if (prefix / 'share' / 'hydro_twin').is_dir():
            return prefix / 'share' / 'hydro_twin'
    raise UserError(f'no share/hydro_twin above {here.parent}: install the package whole')
