"""The parameters of `keep`, its signals aside."""
from __future__ import annotations

from hydro_twin.keep.limits import parse
from hydro_twin.live.settings import Setting, TWIN_MODES

OBSERVE, ASK, AUTO = 'observe', 'ask', 'auto'

SETTINGS = (
    Setting('store', '', 'folder of the model versions; made if it is not there', read_only=True),
    Setting('twin', 'hydro_twin', 'name of the node of the live twin; without a slash in front '
            'it is in the namespace of this node', read_only=True),
    Setting('plant', '', 'plant of the models; if not given, that of the champion, or of the '
            'model that the twin runs', read_only=True),
    Setting('policy', OBSERVE, 'observe: report only, the twin is left alone; ask: promotion by '
            '~/promote; auto: promotion by evidence', choices=(OBSERVE, ASK, AUTO)),
    Setting('mode', 'as the twin', 'mode in which the models are judged',
            choices=('as the twin', *TWIN_MODES)),
    Setting('before', 300.0, 'how much is captured before an event, at most; less where the '
            'residual rose more recently [s]', bounds=(1.0, 86400.0)),
    Setting('after', 120.0, 'how much is captured after an event [s]', bounds=(0.0, 86400.0)),
    Setting('ring', 256.0, 'most memory for captured messages; beyond it the oldest are dropped '
            '[MiB]', bounds=(1.0, 65536.0)),
    Setting('again', 3600.0, 'how long after a capture the next one is made where the model still '
            'does not hold [s]; 0: never', bounds=(0.0, 1e7)),
    Setting('every', 0.0, 'how often a capture is made without an event [s]; 0: never',
            bounds=(0.0, 1e8)),
    Setting('topics', ('',), 'more topics to capture', read_only=True),
    Setting('captures', 20.0, 'how many captures are kept on disk',
            bounds=(1.0, 1e6)),
    Setting('recordings', 3, 'how many recordings of the champion and of those before it a trace '
            'uses besides the new one: the newest, of 1 GiB in all at most', bounds=(0, 100)),
    Setting('trace_time', 1800.0, 'longest time of a trace [s]', bounds=(1.0, 86400.0)),
    Setting('trace_memory', 8192.0, 'most address space of each process of a trace [MiB]',
            bounds=(256.0, 1048576.0)),
    Setting('nice', 19.0, 'niceness of a trace', bounds=(0.0, 19.0)),
    Setting('alpha', 0.01, 'probability of ever promoting a model that is no better, and of '
            'refusing one for a regime in which it is not worse',
            bounds=(1e-9, 0.5)),
    Setting('gain', 0.02, 'least difference of the mean squared residual that counts, as a share',
            bounds=(0.0, 0.9)),
    Setting('trial_least', 60.0, 'how long a challenger is judged at least [s]',
            bounds=(0.0, 86400.0)),
    Setting('trial', 1800.0, 'how long a challenger is judged at most [s]', bounds=(1.0, 1e7)),
    Setting('limits', ('',), 'between which values auto promotes a parameter, NAME=LOW..HIGH, of '
            'an effect ID@PORT:NAME; a model beyond them is only recommended', check=parse),
    Setting('probation', 86400.0, 'how long a new champion is judged against its predecessor at '
            'most [s]; 0: not at all', bounds=(0.0, 1e8)),
)
