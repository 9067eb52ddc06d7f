"""The parameters of keep: sound, and as docs/keep.md has them."""
from pathlib import Path
import re

from hydro_twin.commands.keep import overview
from hydro_twin.keep.settings import SETTINGS

PAGE = (Path(__file__).resolve().parents[2] / 'docs' / 'keep.md').read_text('utf-8')


def test_every_default_is_one_that_the_node_takes():
    for setting in SETTINGS:
        assert not setting.objection(setting.default)
        if setting.bounds:
            assert setting.objection(setting.bounds[1] + 1.0)


def test_the_page_and_the_help_have_them_all():
    table = PAGE.partition('## Parameters')[2].partition('\n**')[0]
    rows = {name: default for names, default in re.findall(r'^\| (`.*?) \| (.*?) \|', table, re.M)
            for name in re.findall(r'`(\w+)`', names)}
    assert rows.keys() == {setting.name for setting in SETTINGS}
    for setting in SETTINGS:
        assert f'  {setting.name}\n' in overview()
        if setting.name in rows and setting.default not in ('', ('',)):
            said = f'{setting.default:g}' if setting.bounds else f'`{setting.default}`'
            assert re.search(rf'(^|\s|`){re.escape(said)}', rows[setting.name]), setting.name
