"""The documents that are read and written, as types, and their JSON Schemas for editors."""
from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import msgspec
from msgspec import field, Meta, Struct, UNSET, UnsetType

from hydro_twin.recording.signals import FIELD, TYPE
from hydro_twin.recording.table_map import UNITS

# YAML reads 1e-3, without a point, as text.
Text = Annotated[str, Meta(pattern=r'^[-+]?[0-9.]+([eE][-+]?[0-9]+)?$')]
Number = float | Text
Column = str | float                # a name that may be a number
Positive = Annotated[float, Meta(gt=0.0)]
NotNegative = Annotated[float, Meta(ge=0.0)]
Probability = Annotated[float, Meta(ge=0.0, le=1.0)]
Errors = dict[str, dict[str, float | None]]      # mode -> part -> RMS
Digest = Annotated[str, Meta(pattern='^[0-9a-f]{64}$')]


class Value(Struct, kw_only=True):
    """A number with its unit."""

    value: float
    unit: Column = ''               # YAML reads 1, of what has no dimension, as a number


class Estimated(Value, kw_only=True):
    """A physical parameter."""

    std_error: Annotated[
        float | Literal['not identifiable', 'held'] | None,
        Meta(description='standard error in the unit of the value')] = None
    at_bound: Annotated[
        Literal['', 'lower', 'upper'] | None,
        Meta(description='bound of its search at which it ended')] = None


class EffectValue(Value, kw_only=True):
    """A parameter of an effect."""

    std_error: float | Literal['not reached'] | None = None


class EffectEntry(Struct, kw_only=True):
    """An effect at a port; of a free curve, the kind of the port and the signal too."""

    id: str
    port: str
    parameters: dict[str, EffectValue]
    kind: str | UnsetType = UNSET
    signal: str | UnsetType = UNSET
    found: str | UnsetType = UNSET


class NoiseEntry(Struct, kw_only=True):
    """What the observer takes as known of noise."""

    measurement_noise: Annotated[Positive, Meta(
        description='standard deviation in the unit of the output')]
    process_noise: Annotated[dict[str, NotNegative], Meta(
        description='intensity on the rate of each state, in its SI unit over the root of a second'
    )]
    start: Annotated[dict[str, NotNegative], Meta(
        description='standard deviation of each state at the start of a run, in its SI unit')]
    follow: Annotated[dict[str, NotNegative], Meta(
        description='parameters that are followed, and the relative change of each over the root '
                    'of a second')] | UnsetType = UNSET
    sensor_noise: Annotated[dict[str, Positive], Meta(
        description='standard deviation of each sensor that the observer uses, in its unit'
    )] | UnsetType = UNSET
    innovation: Annotated[Positive, Meta(
        description='RMS of the standard deviation that the observer expects of its innovation '
                    'with the sensors of the recording, in the unit of the output'
    )] | UnsetType = UNSET


class Bag(Struct, kw_only=True):
    """A recording and its digest."""

    path: str
    sha256: Digest


class Provenance(Struct, kw_only=True):
    """Where a model comes from."""

    bags: tuple[Bag, ...] = ()
    test_bags: tuple[Bag, ...] = ()
    command: str = ''
    seed: int | None = None
    version: str = ''
    method: str | UnsetType = UNSET
    criterion: str | UnsetType = UNSET


class ModelFile(Struct, kw_only=True):
    """A model of hydro_twin."""

    format: Literal[1]
    plant: str
    parameters: dict[str, Estimated]
    sample_time: Annotated[Positive, Meta(description='[s]')]
    predictor: str = 'analytical'
    substeps: Annotated[int, Meta(ge=1, le=1024, description='in a sample')] = 4
    constants: dict[str, Value] | None = None
    timing: Annotated[dict[str, float] | None,
                      Meta(description='how late each input acts [s]')] = None
    interpolation: Annotated[Literal['hold', 'linear'],
                             Meta(description='of commands between samples')] = 'hold'
    effects: tuple[EffectEntry, ...] | None = None
    observer: NoiseEntry | UnsetType = UNSET
    network: Annotated[str | None, Meta(description='file of its weights, beside it')] = None
    notes: tuple[str, ...] | None = None
    errors: Annotated[dict[Literal['before', 'after'], Errors] | None,
                      Meta(description='RMS by part, in the unit of the output')] = None
    provenance: Provenance | None = None


class MapColumn(Struct, kw_only=True, forbid_unknown_fields=True):
    """A column of a table, or the product of some."""

    column: Column | UnsetType = UNSET
    product: Annotated[tuple[Column, ...], Meta(min_length=1)] | UnsetType = UNSET
    unit: Annotated[str, Meta(extra_json_schema={'enum': sorted(UNITS)})] | UnsetType = UNSET
    scale: Number = 1.0
    offset: Number = 0.0


def one_of(first: str, second: str) -> Meta:
    """Say that an object has one of two entries, and not both; or it is a name."""
    return Meta(extra_json_schema={'oneOf': [
        {'type': ['string', 'integer']},
        *({'type': 'object', 'required': [name]} for name in (first, second))]})


MapEntry = Annotated[str | int | MapColumn, one_of('column', 'product')]


class TableMapFile(Struct, kw_only=True, forbid_unknown_fields=True):
    """What the columns of a table are, for `hydro-twin import`."""

    signals: dict[str, MapEntry]
    plant: str = ''
    time: MapEntry | UnsetType = UNSET
    sample_rate: Annotated[Number, Meta(description='[Hz]')] | UnsetType = UNSET
    series: Annotated[Column, Meta(description='a column that changes where a series begins')
                      ] | UnsetType = UNSET
    rows: Annotated[tuple[int | None, int | None],
                    Meta(description='first and last, from 1 up')] | UnsetType = UNSET
    time_range: Annotated[tuple[Number | None, Number | None],
                          Meta(description='begin and end [s]')] | UnsetType = UNSET
    origin: Annotated[str, Meta(description='where the data come from')] = ''
    decimal: Literal['.', ','] = '.'
    header: bool = True


class SignalEntry(Struct, kw_only=True, forbid_unknown_fields=True):
    """Where a signal is in the messages: scale * field + offset."""

    topic: str | UnsetType = UNSET
    type: Annotated[str, Meta(pattern=f'^{TYPE.pattern}$')] | UnsetType = UNSET
    field: Annotated[str, Meta(pattern=f'^{FIELD.pattern}$')] | UnsetType = UNSET
    scale: Number = 1.0
    offset: Number = 0.0


class ConfigParameters(Struct, kw_only=True):
    """The parameters of the node and of the offline verbs; others are ROS's own."""

    plant: str = ''
    sample_time: Annotated[Number, Meta(description='[s]')] | UnsetType = UNSET
    signals: dict[str, SignalEntry] = field(default_factory=dict)
    constants: dict[str, Number] = field(default_factory=dict)
    model: str = ''
    models: tuple[str, ...] = ()
    mode: Literal['one_step', 'observer', 'free_run'] = 'observer'
    horizon: Annotated[int, Meta(ge=1, le=10_000, description='samples')] = 1
    follow: tuple[str, ...] = ()
    wait: Annotated[float, Meta(ge=0.0, le=10.0, description='[s]')] = 0.1
    autostart: bool = True


class ConfigNode(Struct, kw_only=True):
    """What one node is given."""

    ros__parameters: ConfigParameters


Config = Annotated[dict[str, ConfigNode], Meta(
    title='ConfigFile', min_length=1,
    description="A ROS parameter file: name of a node, or '/**', to its parameters.")]


class ReportValue(Struct, kw_only=True):
    """A parameter in a report."""

    value: float
    unit: str
    std_error: float | None


class Rival(Struct, kw_only=True):
    """Another effect in the place of one."""

    id: str
    delta_bic: float


class ReportEffect(Struct, kw_only=True):
    """An effect that was found."""

    id: str
    port: str
    or_ports: tuple[str, ...]
    parameters: dict[str, ReportValue]
    p_value: float
    share_of_residual: float
    certain: bool
    probability: Annotated[Probability, Meta(description='that this is the law')]
    ports: Annotated[dict[str, Probability], Meta(
        description='probability of each port, given the effect')]
    rivals: tuple[Rival, ...]
    given: Annotated[dict[str, dict[str, float]], Meta(
        description='parameters of the effect that depend on parameters of the plant which the '
                    'recording does not determine, with the values taken for these')]


class Remainder(Struct, kw_only=True):
    """The residual at the end."""

    white: bool
    lines_hz: tuple[float, ...]
    depends_on: tuple[dict[str, Any], ...]
    when: tuple[dict[str, Any], ...]
    drifts: bool
    predicted_by_ports: dict[str, float]
    says: str


class SeriesEntry(Struct, kw_only=True):
    """The errors on one series."""

    bag: str
    before: Errors
    after: Errors


class OutputEntry(Struct, kw_only=True):
    """The errors of the free run on the output or a sensor by part, in its unit."""

    unit: str
    before: dict[str, float | None]
    after: dict[str, float | None]
    noise: float


class Hidden(Struct, kw_only=True):
    """An effect that the recording cannot show."""

    id: str
    port: str
    says: str


class Memory(Struct, kw_only=True):
    """What the recordings that the model at the start came from add."""

    bags: tuple[str, ...]
    used: bool
    moved: tuple[str, ...]
    held_out: dict[Literal['before', 'after'], float]
    says: str


class ReportFile(Struct, kw_only=True):
    """What `hydro-twin trace` found; errors are RMS in the unit of the output."""

    plant: str
    verdict: Literal['effect_found', 'nothing_missing', 'unexplained']
    says: str
    nothing: Annotated[Probability, Meta(description='that nothing is missing')]
    law_unknown: Annotated[Probability, Meta(
        description='that a law is missing which is not known; what both leave of 1 is that of '
                    'the effects named')]
    evidence_left: Annotated[NotNegative, Meta(
        description='what the port signals predict of the residual, as a log-likelihood [nats]')]
    tested: str
    effects: tuple[ReportEffect, ...]
    found: dict[str, Any] | None
    best_named: dict[str, Any] | None
    ambiguous: tuple[tuple[str, ...], ...]
    horizon_s: float | None
    interpolation: Annotated[Literal['hold', 'linear'],
                             Meta(description='of commands between samples')]
    before: Errors
    after: Errors
    improvement: dict[Literal['relative', 'low', 'high'], float]
    cannot_show: tuple[Hidden, ...]
    outputs: dict[str, OutputEntry]
    series: tuple[SeriesEntry, ...]
    parameters: dict[Literal['before', 'after'], dict[str, ReportValue]]
    persistence: dict[str, float]
    noise_floor: float
    memory: Memory | None
    remainder: Remainder


DOCUMENTS: Mapping[str, Any] = {
    'model': ModelFile,
    'report': ReportFile,
    'config': Config,
    'map': Annotated[TableMapFile, one_of('time', 'sample_rate')],
}


def json_schema(document: str) -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of one of DOCUMENTS."""
    schema = {'$schema': 'https://json-schema.org/draft/2020-12/schema',
              **msgspec.json.schema(DOCUMENTS[document])}
    plain: dict[str, Any] = msgspec.json.decode(msgspec.json.encode(schema))    # no tuples
    return plain


def fault(raw: object, document: str) -> str:
    """Say in what a document, as YAML or JSON gives it, is not of its type; '' if it is."""
    try:
        msgspec.convert(raw, DOCUMENTS[document])
    except msgspec.ValidationError as error:
        return str(error)
    return ''
