from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class BackendChoice(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    BACKEND_CHOICE_UNSPECIFIED: _ClassVar[BackendChoice]
    BACKEND_CHOICE_AUTO: _ClassVar[BackendChoice]
    BACKEND_CHOICE_GPU: _ClassVar[BackendChoice]
    BACKEND_CHOICE_PARALLEL: _ClassVar[BackendChoice]
    BACKEND_CHOICE_SERIAL: _ClassVar[BackendChoice]

class PositionType(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    POSITION_TYPE_UNSPECIFIED: _ClassVar[PositionType]
    POSITION_TYPE_F32: _ClassVar[PositionType]
    POSITION_TYPE_F64: _ClassVar[PositionType]

class Projection(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    PROJECTION_UNSPECIFIED: _ClassVar[Projection]
    PROJECTION_FREE: _ClassVar[Projection]
    PROJECTION_SURFACE: _ClassVar[Projection]

class ArrayKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    ARRAY_KIND_UNSPECIFIED: _ClassVar[ArrayKind]
    ARRAY_KIND_POSITIONS: _ClassVar[ArrayKind]
    ARRAY_KIND_FACETS: _ClassVar[ArrayKind]
    ARRAY_KIND_WEIGHTS: _ClassVar[ArrayKind]
    ARRAY_KIND_SEEDS: _ClassVar[ArrayKind]
    ARRAY_KIND_VERTEX_SEEDS: _ClassVar[ArrayKind]
    ARRAY_KIND_CENTROIDS: _ClassVar[ArrayKind]
    ARRAY_KIND_MASSES: _ClassVar[ArrayKind]
    ARRAY_KIND_AREAS: _ClassVar[ArrayKind]
    ARRAY_KIND_ENERGIES: _ClassVar[ArrayKind]
    ARRAY_KIND_CREASES: _ClassVar[ArrayKind]
    ARRAY_KIND_EDGE_LENGTHS: _ClassVar[ArrayKind]
    ARRAY_KIND_METRIC: _ClassVar[ArrayKind]
    ARRAY_KIND_NORMALS: _ClassVar[ArrayKind]
    ARRAY_KIND_NORMAL_CORNERS: _ClassVar[ArrayKind]
    ARRAY_KIND_TEXTURE_COORDINATES: _ClassVar[ArrayKind]
    ARRAY_KIND_TEXTURE_CORNERS: _ClassVar[ArrayKind]
    ARRAY_KIND_COLOURS: _ClassVar[ArrayKind]
    ARRAY_KIND_SCALARS: _ClassVar[ArrayKind]
    ARRAY_KIND_REGIONS: _ClassVar[ArrayKind]
    ARRAY_KIND_REPORT: _ClassVar[ArrayKind]

class RvdOutput(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    RVD_OUTPUT_UNSPECIFIED: _ClassVar[RvdOutput]
    RVD_OUTPUT_CELLS: _ClassVar[RvdOutput]
    RVD_OUTPUT_CENTROIDS: _ClassVar[RvdOutput]
    RVD_OUTPUT_SUMS: _ClassVar[RvdOutput]

class AttributeKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    ATTRIBUTE_KIND_UNSPECIFIED: _ClassVar[AttributeKind]
    ATTRIBUTE_KIND_NORMALS: _ClassVar[AttributeKind]
    ATTRIBUTE_KIND_TEXTURE_COORDINATES: _ClassVar[AttributeKind]
    ATTRIBUTE_KIND_COLOURS: _ClassVar[AttributeKind]
    ATTRIBUTE_KIND_SCALAR: _ClassVar[AttributeKind]
    ATTRIBUTE_KIND_REGIONS: _ClassVar[AttributeKind]

class AttributeType(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    ATTRIBUTE_TYPE_UNSPECIFIED: _ClassVar[AttributeType]
    ATTRIBUTE_TYPE_F32: _ClassVar[AttributeType]
    ATTRIBUTE_TYPE_F64: _ClassVar[AttributeType]
    ATTRIBUTE_TYPE_U8: _ClassVar[AttributeType]
    ATTRIBUTE_TYPE_I8: _ClassVar[AttributeType]
    ATTRIBUTE_TYPE_U16: _ClassVar[AttributeType]
    ATTRIBUTE_TYPE_I16: _ClassVar[AttributeType]
    ATTRIBUTE_TYPE_U32: _ClassVar[AttributeType]
    ATTRIBUTE_TYPE_I32: _ClassVar[AttributeType]
    ATTRIBUTE_TYPE_U64: _ClassVar[AttributeType]
    ATTRIBUTE_TYPE_I64: _ClassVar[AttributeType]

class DensitySource(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    DENSITY_SOURCE_UNSPECIFIED: _ClassVar[DensitySource]
    DENSITY_SOURCE_UNIFORM: _ClassVar[DensitySource]
    DENSITY_SOURCE_WEIGHTS: _ClassVar[DensitySource]
    DENSITY_SOURCE_EDGE_LENGTHS: _ClassVar[DensitySource]
    DENSITY_SOURCE_CURVATURE: _ClassVar[DensitySource]
    DENSITY_SOURCE_LFS: _ClassVar[DensitySource]
    DENSITY_SOURCE_ERROR: _ClassVar[DensitySource]
    DENSITY_SOURCE_ERROR_MAX: _ClassVar[DensitySource]
    DENSITY_SOURCE_METRIC: _ClassVar[DensitySource]

class StepKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    STEP_KIND_UNSPECIFIED: _ClassVar[StepKind]
    STEP_KIND_LLOYD: _ClassVar[StepKind]
    STEP_KIND_LBFGS: _ClassVar[StepKind]

class SeedsWanted(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    SEEDS_WANTED_UNSPECIFIED: _ClassVar[SeedsWanted]
    SEEDS_WANTED_NEVER: _ClassVar[SeedsWanted]
    SEEDS_WANTED_LAST: _ClassVar[SeedsWanted]
    SEEDS_WANTED_EACH: _ClassVar[SeedsWanted]

class Placement(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    PLACEMENT_UNSPECIFIED: _ClassVar[Placement]
    PLACEMENT_FITTED: _ClassVar[Placement]
    PLACEMENT_SURFACE: _ClassVar[Placement]
    PLACEMENT_CENTROIDS: _ClassVar[Placement]

class BoundaryRule(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    BOUNDARY_RULE_UNSPECIFIED: _ClassVar[BoundaryRule]
    BOUNDARY_RULE_KEEP: _ClassVar[BoundaryRule]
    BOUNDARY_RULE_FREE: _ClassVar[BoundaryRule]

class ThinRule(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    THIN_RULE_UNSPECIFIED: _ClassVar[ThinRule]
    THIN_RULE_FINER: _ClassVar[ThinRule]
    THIN_RULE_EVEN: _ClassVar[ThinRule]

class NonManifoldRule(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    NON_MANIFOLD_RULE_UNSPECIFIED: _ClassVar[NonManifoldRule]
    NON_MANIFOLD_RULE_CUT: _ClassVar[NonManifoldRule]
    NON_MANIFOLD_RULE_KEEP: _ClassVar[NonManifoldRule]

class Measure(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    MEASURE_UNSPECIFIED: _ClassVar[Measure]
    MEASURE_TOPOLOGY: _ClassVar[Measure]
    MEASURE_FULL: _ClassVar[Measure]

class RefinementEnd(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    REFINEMENT_END_UNSPECIFIED: _ClassVar[RefinementEnd]
    REFINEMENT_END_REACHED: _ClassVar[RefinementEnd]
    REFINEMENT_END_BUDGET: _ClassVar[RefinementEnd]
    REFINEMENT_END_NO_PROGRESS: _ClassVar[RefinementEnd]
BACKEND_CHOICE_UNSPECIFIED: BackendChoice
BACKEND_CHOICE_AUTO: BackendChoice
BACKEND_CHOICE_GPU: BackendChoice
BACKEND_CHOICE_PARALLEL: BackendChoice
BACKEND_CHOICE_SERIAL: BackendChoice
POSITION_TYPE_UNSPECIFIED: PositionType
POSITION_TYPE_F32: PositionType
POSITION_TYPE_F64: PositionType
PROJECTION_UNSPECIFIED: Projection
PROJECTION_FREE: Projection
PROJECTION_SURFACE: Projection
ARRAY_KIND_UNSPECIFIED: ArrayKind
ARRAY_KIND_POSITIONS: ArrayKind
ARRAY_KIND_FACETS: ArrayKind
ARRAY_KIND_WEIGHTS: ArrayKind
ARRAY_KIND_SEEDS: ArrayKind
ARRAY_KIND_VERTEX_SEEDS: ArrayKind
ARRAY_KIND_CENTROIDS: ArrayKind
ARRAY_KIND_MASSES: ArrayKind
ARRAY_KIND_AREAS: ArrayKind
ARRAY_KIND_ENERGIES: ArrayKind
ARRAY_KIND_CREASES: ArrayKind
ARRAY_KIND_EDGE_LENGTHS: ArrayKind
ARRAY_KIND_METRIC: ArrayKind
ARRAY_KIND_NORMALS: ArrayKind
ARRAY_KIND_NORMAL_CORNERS: ArrayKind
ARRAY_KIND_TEXTURE_COORDINATES: ArrayKind
ARRAY_KIND_TEXTURE_CORNERS: ArrayKind
ARRAY_KIND_COLOURS: ArrayKind
ARRAY_KIND_SCALARS: ArrayKind
ARRAY_KIND_REGIONS: ArrayKind
ARRAY_KIND_REPORT: ArrayKind
RVD_OUTPUT_UNSPECIFIED: RvdOutput
RVD_OUTPUT_CELLS: RvdOutput
RVD_OUTPUT_CENTROIDS: RvdOutput
RVD_OUTPUT_SUMS: RvdOutput
ATTRIBUTE_KIND_UNSPECIFIED: AttributeKind
ATTRIBUTE_KIND_NORMALS: AttributeKind
ATTRIBUTE_KIND_TEXTURE_COORDINATES: AttributeKind
ATTRIBUTE_KIND_COLOURS: AttributeKind
ATTRIBUTE_KIND_SCALAR: AttributeKind
ATTRIBUTE_KIND_REGIONS: AttributeKind
ATTRIBUTE_TYPE_UNSPECIFIED: AttributeType
ATTRIBUTE_TYPE_F32: AttributeType
ATTRIBUTE_TYPE_F64: AttributeType
ATTRIBUTE_TYPE_U8: AttributeType
ATTRIBUTE_TYPE_I8: AttributeType
ATTRIBUTE_TYPE_U16: AttributeType
ATTRIBUTE_TYPE_I16: AttributeType
ATTRIBUTE_TYPE_U32: AttributeType
ATTRIBUTE_TYPE_I32: AttributeType
ATTRIBUTE_TYPE_U64: AttributeType
ATTRIBUTE_TYPE_I64: AttributeType
DENSITY_SOURCE_UNSPECIFIED: DensitySource
DENSITY_SOURCE_UNIFORM: DensitySource
DENSITY_SOURCE_WEIGHTS: DensitySource
DENSITY_SOURCE_EDGE_LENGTHS: DensitySource
DENSITY_SOURCE_CURVATURE: DensitySource
DENSITY_SOURCE_LFS: DensitySource
DENSITY_SOURCE_ERROR: DensitySource
DENSITY_SOURCE_ERROR_MAX: DensitySource
DENSITY_SOURCE_METRIC: DensitySource
STEP_KIND_UNSPECIFIED: StepKind
STEP_KIND_LLOYD: StepKind
STEP_KIND_LBFGS: StepKind
SEEDS_WANTED_UNSPECIFIED: SeedsWanted
SEEDS_WANTED_NEVER: SeedsWanted
SEEDS_WANTED_LAST: SeedsWanted
SEEDS_WANTED_EACH: SeedsWanted
PLACEMENT_UNSPECIFIED: Placement
PLACEMENT_FITTED: Placement
PLACEMENT_SURFACE: Placement
PLACEMENT_CENTROIDS: Placement
BOUNDARY_RULE_UNSPECIFIED: BoundaryRule
BOUNDARY_RULE_KEEP: BoundaryRule
BOUNDARY_RULE_FREE: BoundaryRule
THIN_RULE_UNSPECIFIED: ThinRule
THIN_RULE_FINER: ThinRule
THIN_RULE_EVEN: ThinRule
NON_MANIFOLD_RULE_UNSPECIFIED: NonManifoldRule
NON_MANIFOLD_RULE_CUT: NonManifoldRule
NON_MANIFOLD_RULE_KEEP: NonManifoldRule
MEASURE_UNSPECIFIED: Measure
MEASURE_TOPOLOGY: Measure
MEASURE_FULL: Measure
REFINEMENT_END_UNSPECIFIED: RefinementEnd
REFINEMENT_END_REACHED: RefinementEnd
REFINEMENT_END_BUDGET: RefinementEnd
REFINEMENT_END_NO_PROGRESS: RefinementEnd

class Chunk(_message.Message):
    __slots__ = ("kind", "offset", "data", "crc32c", "total_bytes", "attribute")
    KIND_FIELD_NUMBER: _ClassVar[int]
    OFFSET_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    CRC32C_FIELD_NUMBER: _ClassVar[int]
    TOTAL_BYTES_FIELD_NUMBER: _ClassVar[int]
    ATTRIBUTE_FIELD_NUMBER: _ClassVar[int]
    kind: ArrayKind
    offset: int
    data: bytes
    crc32c: int
    total_bytes: int
    attribute: int
    def __init__(self, kind: _Optional[_Union[ArrayKind, str]] = ..., offset: _Optional[int] = ..., data: _Optional[bytes] = ..., crc32c: _Optional[int] = ..., total_bytes: _Optional[int] = ..., attribute: _Optional[int] = ...) -> None: ...

class Region(_message.Message):
    __slots__ = ("number", "name")
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    number: int
    name: str
    def __init__(self, number: _Optional[int] = ..., name: _Optional[str] = ...) -> None: ...

class AttributeHeader(_message.Message):
    __slots__ = ("kind", "name", "type", "values", "by_corner", "components", "regions")
    KIND_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    TYPE_FIELD_NUMBER: _ClassVar[int]
    VALUES_FIELD_NUMBER: _ClassVar[int]
    BY_CORNER_FIELD_NUMBER: _ClassVar[int]
    COMPONENTS_FIELD_NUMBER: _ClassVar[int]
    REGIONS_FIELD_NUMBER: _ClassVar[int]
    kind: AttributeKind
    name: str
    type: AttributeType
    values: int
    by_corner: bool
    components: int
    regions: _containers.RepeatedCompositeFieldContainer[Region]
    def __init__(self, kind: _Optional[_Union[AttributeKind, str]] = ..., name: _Optional[str] = ..., type: _Optional[_Union[AttributeType, str]] = ..., values: _Optional[int] = ..., by_corner: bool = ..., components: _Optional[int] = ..., regions: _Optional[_Iterable[_Union[Region, _Mapping]]] = ...) -> None: ...

class MeshHeader(_message.Message):
    __slots__ = ("vertices", "facets", "position_type", "weights", "edge_lengths", "creases", "attributes", "metric")
    VERTICES_FIELD_NUMBER: _ClassVar[int]
    FACETS_FIELD_NUMBER: _ClassVar[int]
    POSITION_TYPE_FIELD_NUMBER: _ClassVar[int]
    WEIGHTS_FIELD_NUMBER: _ClassVar[int]
    EDGE_LENGTHS_FIELD_NUMBER: _ClassVar[int]
    CREASES_FIELD_NUMBER: _ClassVar[int]
    ATTRIBUTES_FIELD_NUMBER: _ClassVar[int]
    METRIC_FIELD_NUMBER: _ClassVar[int]
    vertices: int
    facets: int
    position_type: PositionType
    weights: int
    edge_lengths: int
    creases: int
    attributes: _containers.RepeatedCompositeFieldContainer[AttributeHeader]
    metric: int
    def __init__(self, vertices: _Optional[int] = ..., facets: _Optional[int] = ..., position_type: _Optional[_Union[PositionType, str]] = ..., weights: _Optional[int] = ..., edge_lengths: _Optional[int] = ..., creases: _Optional[int] = ..., attributes: _Optional[_Iterable[_Union[AttributeHeader, _Mapping]]] = ..., metric: _Optional[int] = ...) -> None: ...

class Density(_message.Message):
    __slots__ = ("source", "edge_length", "adaptivity", "gradation", "size_in")
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    EDGE_LENGTH_FIELD_NUMBER: _ClassVar[int]
    ADAPTIVITY_FIELD_NUMBER: _ClassVar[int]
    GRADATION_FIELD_NUMBER: _ClassVar[int]
    SIZE_IN_FIELD_NUMBER: _ClassVar[int]
    source: DensitySource
    edge_length: float
    adaptivity: float
    gradation: float
    size_in: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, source: _Optional[_Union[DensitySource, str]] = ..., edge_length: _Optional[float] = ..., adaptivity: _Optional[float] = ..., gradation: _Optional[float] = ..., size_in: _Optional[_Iterable[str]] = ...) -> None: ...

class RemeshOptions(_message.Message):
    __slots__ = ("points", "seed", "density", "lloyd", "newton", "projection", "placement", "crease_angle", "boundaries", "thin", "max_deviation", "max_deviation_length", "max_points", "measure", "points_percent", "facets", "anisotropy", "anisotropy_auto", "weld", "weld_percent", "non_manifold", "keep", "only", "keep_rims", "source_map", "mirror", "periodic", "strict_creases")
    POINTS_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    DENSITY_FIELD_NUMBER: _ClassVar[int]
    LLOYD_FIELD_NUMBER: _ClassVar[int]
    NEWTON_FIELD_NUMBER: _ClassVar[int]
    PROJECTION_FIELD_NUMBER: _ClassVar[int]
    PLACEMENT_FIELD_NUMBER: _ClassVar[int]
    CREASE_ANGLE_FIELD_NUMBER: _ClassVar[int]
    BOUNDARIES_FIELD_NUMBER: _ClassVar[int]
    THIN_FIELD_NUMBER: _ClassVar[int]
    MAX_DEVIATION_FIELD_NUMBER: _ClassVar[int]
    MAX_DEVIATION_LENGTH_FIELD_NUMBER: _ClassVar[int]
    MAX_POINTS_FIELD_NUMBER: _ClassVar[int]
    MEASURE_FIELD_NUMBER: _ClassVar[int]
    POINTS_PERCENT_FIELD_NUMBER: _ClassVar[int]
    FACETS_FIELD_NUMBER: _ClassVar[int]
    ANISOTROPY_FIELD_NUMBER: _ClassVar[int]
    ANISOTROPY_AUTO_FIELD_NUMBER: _ClassVar[int]
    WELD_FIELD_NUMBER: _ClassVar[int]
    WELD_PERCENT_FIELD_NUMBER: _ClassVar[int]
    NON_MANIFOLD_FIELD_NUMBER: _ClassVar[int]
    KEEP_FIELD_NUMBER: _ClassVar[int]
    ONLY_FIELD_NUMBER: _ClassVar[int]
    KEEP_RIMS_FIELD_NUMBER: _ClassVar[int]
    SOURCE_MAP_FIELD_NUMBER: _ClassVar[int]
    MIRROR_FIELD_NUMBER: _ClassVar[int]
    PERIODIC_FIELD_NUMBER: _ClassVar[int]
    STRICT_CREASES_FIELD_NUMBER: _ClassVar[int]
    points: int
    seed: int
    density: Density
    lloyd: int
    newton: int
    projection: Projection
    placement: Placement
    crease_angle: float
    boundaries: BoundaryRule
    thin: ThinRule
    max_deviation: float
    max_deviation_length: float
    max_points: int
    measure: Measure
    points_percent: float
    facets: int
    anisotropy: float
    anisotropy_auto: bool
    weld: float
    weld_percent: float
    non_manifold: NonManifoldRule
    keep: _containers.RepeatedScalarFieldContainer[str]
    only: _containers.RepeatedScalarFieldContainer[str]
    keep_rims: bool
    source_map: bool
    mirror: str
    periodic: _containers.RepeatedScalarFieldContainer[str]
    strict_creases: bool
    def __init__(self, points: _Optional[int] = ..., seed: _Optional[int] = ..., density: _Optional[_Union[Density, _Mapping]] = ..., lloyd: _Optional[int] = ..., newton: _Optional[int] = ..., projection: _Optional[_Union[Projection, str]] = ..., placement: _Optional[_Union[Placement, str]] = ..., crease_angle: _Optional[float] = ..., boundaries: _Optional[_Union[BoundaryRule, str]] = ..., thin: _Optional[_Union[ThinRule, str]] = ..., max_deviation: _Optional[float] = ..., max_deviation_length: _Optional[float] = ..., max_points: _Optional[int] = ..., measure: _Optional[_Union[Measure, str]] = ..., points_percent: _Optional[float] = ..., facets: _Optional[int] = ..., anisotropy: _Optional[float] = ..., anisotropy_auto: bool = ..., weld: _Optional[float] = ..., weld_percent: _Optional[float] = ..., non_manifold: _Optional[_Union[NonManifoldRule, str]] = ..., keep: _Optional[_Iterable[str]] = ..., only: _Optional[_Iterable[str]] = ..., keep_rims: bool = ..., source_map: bool = ..., mirror: _Optional[str] = ..., periodic: _Optional[_Iterable[str]] = ..., strict_creases: bool = ...) -> None: ...

class DiagramOptions(_message.Message):
    __slots__ = ("points", "seed", "outputs", "points_percent")
    POINTS_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    OUTPUTS_FIELD_NUMBER: _ClassVar[int]
    POINTS_PERCENT_FIELD_NUMBER: _ClassVar[int]
    points: int
    seed: int
    outputs: _containers.RepeatedScalarFieldContainer[RvdOutput]
    points_percent: float
    def __init__(self, points: _Optional[int] = ..., seed: _Optional[int] = ..., outputs: _Optional[_Iterable[_Union[RvdOutput, str]]] = ..., points_percent: _Optional[float] = ...) -> None: ...

class CvtOptions(_message.Message):
    __slots__ = ("points", "seed", "density", "projection", "max_seeds", "points_percent")
    POINTS_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    DENSITY_FIELD_NUMBER: _ClassVar[int]
    PROJECTION_FIELD_NUMBER: _ClassVar[int]
    MAX_SEEDS_FIELD_NUMBER: _ClassVar[int]
    POINTS_PERCENT_FIELD_NUMBER: _ClassVar[int]
    points: int
    seed: int
    density: Density
    projection: Projection
    max_seeds: int
    points_percent: float
    def __init__(self, points: _Optional[int] = ..., seed: _Optional[int] = ..., density: _Optional[_Union[Density, _Mapping]] = ..., projection: _Optional[_Union[Projection, str]] = ..., max_seeds: _Optional[int] = ..., points_percent: _Optional[float] = ...) -> None: ...

class Finish(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class Accepted(_message.Message):
    __slots__ = ("queue_position", "backend", "adapter", "threads")
    QUEUE_POSITION_FIELD_NUMBER: _ClassVar[int]
    BACKEND_FIELD_NUMBER: _ClassVar[int]
    ADAPTER_FIELD_NUMBER: _ClassVar[int]
    THREADS_FIELD_NUMBER: _ClassVar[int]
    queue_position: int
    backend: str
    adapter: str
    threads: int
    def __init__(self, queue_position: _Optional[int] = ..., backend: _Optional[str] = ..., adapter: _Optional[str] = ..., threads: _Optional[int] = ...) -> None: ...

class Timing(_message.Message):
    __slots__ = ("queue_ms", "compute_ms")
    QUEUE_MS_FIELD_NUMBER: _ClassVar[int]
    COMPUTE_MS_FIELD_NUMBER: _ClassVar[int]
    queue_ms: float
    compute_ms: float
    def __init__(self, queue_ms: _Optional[float] = ..., compute_ms: _Optional[float] = ...) -> None: ...

class Progress(_message.Message):
    __slots__ = ("stage", "done", "total", "timing")
    STAGE_FIELD_NUMBER: _ClassVar[int]
    DONE_FIELD_NUMBER: _ClassVar[int]
    TOTAL_FIELD_NUMBER: _ClassVar[int]
    TIMING_FIELD_NUMBER: _ClassVar[int]
    stage: str
    done: int
    total: int
    timing: Timing
    def __init__(self, stage: _Optional[str] = ..., done: _Optional[int] = ..., total: _Optional[int] = ..., timing: _Optional[_Union[Timing, _Mapping]] = ...) -> None: ...

class Iteration(_message.Message):
    __slots__ = ("index", "kind", "energy", "energy_ratio", "gradient_norm", "evaluations", "empty_cells", "area", "pairs", "ms", "relaunched_pairs", "total", "queue_ms", "host_searches", "device_submissions", "device_allocations", "uploaded_bytes", "read_back_bytes", "divided_facets", "paired_facets")
    INDEX_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    ENERGY_FIELD_NUMBER: _ClassVar[int]
    ENERGY_RATIO_FIELD_NUMBER: _ClassVar[int]
    GRADIENT_NORM_FIELD_NUMBER: _ClassVar[int]
    EVALUATIONS_FIELD_NUMBER: _ClassVar[int]
    EMPTY_CELLS_FIELD_NUMBER: _ClassVar[int]
    AREA_FIELD_NUMBER: _ClassVar[int]
    PAIRS_FIELD_NUMBER: _ClassVar[int]
    MS_FIELD_NUMBER: _ClassVar[int]
    RELAUNCHED_PAIRS_FIELD_NUMBER: _ClassVar[int]
    TOTAL_FIELD_NUMBER: _ClassVar[int]
    QUEUE_MS_FIELD_NUMBER: _ClassVar[int]
    HOST_SEARCHES_FIELD_NUMBER: _ClassVar[int]
    DEVICE_SUBMISSIONS_FIELD_NUMBER: _ClassVar[int]
    DEVICE_ALLOCATIONS_FIELD_NUMBER: _ClassVar[int]
    UPLOADED_BYTES_FIELD_NUMBER: _ClassVar[int]
    READ_BACK_BYTES_FIELD_NUMBER: _ClassVar[int]
    DIVIDED_FACETS_FIELD_NUMBER: _ClassVar[int]
    PAIRED_FACETS_FIELD_NUMBER: _ClassVar[int]
    index: int
    kind: str
    energy: float
    energy_ratio: float
    gradient_norm: float
    evaluations: int
    empty_cells: int
    area: float
    pairs: int
    ms: float
    relaunched_pairs: int
    total: int
    queue_ms: float
    host_searches: int
    device_submissions: int
    device_allocations: int
    uploaded_bytes: int
    read_back_bytes: int
    divided_facets: int
    paired_facets: int
    def __init__(self, index: _Optional[int] = ..., kind: _Optional[str] = ..., energy: _Optional[float] = ..., energy_ratio: _Optional[float] = ..., gradient_norm: _Optional[float] = ..., evaluations: _Optional[int] = ..., empty_cells: _Optional[int] = ..., area: _Optional[float] = ..., pairs: _Optional[int] = ..., ms: _Optional[float] = ..., relaunched_pairs: _Optional[int] = ..., total: _Optional[int] = ..., queue_ms: _Optional[float] = ..., host_searches: _Optional[int] = ..., device_submissions: _Optional[int] = ..., device_allocations: _Optional[int] = ..., uploaded_bytes: _Optional[int] = ..., read_back_bytes: _Optional[int] = ..., divided_facets: _Optional[int] = ..., paired_facets: _Optional[int] = ...) -> None: ...

class CellsChunk(_message.Message):
    __slots__ = ("pieces", "vertices", "facet", "seed", "vertex_count", "positions", "weights", "opposite")
    PIECES_FIELD_NUMBER: _ClassVar[int]
    VERTICES_FIELD_NUMBER: _ClassVar[int]
    FACET_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    VERTEX_COUNT_FIELD_NUMBER: _ClassVar[int]
    POSITIONS_FIELD_NUMBER: _ClassVar[int]
    WEIGHTS_FIELD_NUMBER: _ClassVar[int]
    OPPOSITE_FIELD_NUMBER: _ClassVar[int]
    pieces: int
    vertices: int
    facet: bytes
    seed: bytes
    vertex_count: bytes
    positions: bytes
    weights: bytes
    opposite: bytes
    def __init__(self, pieces: _Optional[int] = ..., vertices: _Optional[int] = ..., facet: _Optional[bytes] = ..., seed: _Optional[bytes] = ..., vertex_count: _Optional[bytes] = ..., positions: _Optional[bytes] = ..., weights: _Optional[bytes] = ..., opposite: _Optional[bytes] = ...) -> None: ...

class RvdFigures(_message.Message):
    __slots__ = ("area", "pairs", "relaunched_pairs", "f64_finished_pairs", "empty_cells", "duplicate_seeds")
    AREA_FIELD_NUMBER: _ClassVar[int]
    PAIRS_FIELD_NUMBER: _ClassVar[int]
    RELAUNCHED_PAIRS_FIELD_NUMBER: _ClassVar[int]
    F64_FINISHED_PAIRS_FIELD_NUMBER: _ClassVar[int]
    EMPTY_CELLS_FIELD_NUMBER: _ClassVar[int]
    DUPLICATE_SEEDS_FIELD_NUMBER: _ClassVar[int]
    area: float
    pairs: int
    relaunched_pairs: int
    f64_finished_pairs: int
    empty_cells: int
    duplicate_seeds: int
    def __init__(self, area: _Optional[float] = ..., pairs: _Optional[int] = ..., relaunched_pairs: _Optional[int] = ..., f64_finished_pairs: _Optional[int] = ..., empty_cells: _Optional[int] = ..., duplicate_seeds: _Optional[int] = ...) -> None: ...

class ComputeRvdHeader(_message.Message):
    __slots__ = ("mesh", "seeds", "backend", "options")
    MESH_FIELD_NUMBER: _ClassVar[int]
    SEEDS_FIELD_NUMBER: _ClassVar[int]
    BACKEND_FIELD_NUMBER: _ClassVar[int]
    OPTIONS_FIELD_NUMBER: _ClassVar[int]
    mesh: MeshHeader
    seeds: int
    backend: BackendChoice
    options: DiagramOptions
    def __init__(self, mesh: _Optional[_Union[MeshHeader, _Mapping]] = ..., seeds: _Optional[int] = ..., backend: _Optional[_Union[BackendChoice, str]] = ..., options: _Optional[_Union[DiagramOptions, _Mapping]] = ...) -> None: ...

class ComputeRvdRequest(_message.Message):
    __slots__ = ("header", "chunk", "finish")
    HEADER_FIELD_NUMBER: _ClassVar[int]
    CHUNK_FIELD_NUMBER: _ClassVar[int]
    FINISH_FIELD_NUMBER: _ClassVar[int]
    header: ComputeRvdHeader
    chunk: Chunk
    finish: Finish
    def __init__(self, header: _Optional[_Union[ComputeRvdHeader, _Mapping]] = ..., chunk: _Optional[_Union[Chunk, _Mapping]] = ..., finish: _Optional[_Union[Finish, _Mapping]] = ...) -> None: ...

class RvdDone(_message.Message):
    __slots__ = ("backend", "adapter", "timing", "figures", "seeds", "report_json")
    BACKEND_FIELD_NUMBER: _ClassVar[int]
    ADAPTER_FIELD_NUMBER: _ClassVar[int]
    TIMING_FIELD_NUMBER: _ClassVar[int]
    FIGURES_FIELD_NUMBER: _ClassVar[int]
    SEEDS_FIELD_NUMBER: _ClassVar[int]
    REPORT_JSON_FIELD_NUMBER: _ClassVar[int]
    backend: str
    adapter: str
    timing: Timing
    figures: RvdFigures
    seeds: int
    report_json: str
    def __init__(self, backend: _Optional[str] = ..., adapter: _Optional[str] = ..., timing: _Optional[_Union[Timing, _Mapping]] = ..., figures: _Optional[_Union[RvdFigures, _Mapping]] = ..., seeds: _Optional[int] = ..., report_json: _Optional[str] = ...) -> None: ...

class ComputeRvdResponse(_message.Message):
    __slots__ = ("accepted", "progress", "cells", "chunk", "done")
    ACCEPTED_FIELD_NUMBER: _ClassVar[int]
    PROGRESS_FIELD_NUMBER: _ClassVar[int]
    CELLS_FIELD_NUMBER: _ClassVar[int]
    CHUNK_FIELD_NUMBER: _ClassVar[int]
    DONE_FIELD_NUMBER: _ClassVar[int]
    accepted: Accepted
    progress: Progress
    cells: CellsChunk
    chunk: Chunk
    done: RvdDone
    def __init__(self, accepted: _Optional[_Union[Accepted, _Mapping]] = ..., progress: _Optional[_Union[Progress, _Mapping]] = ..., cells: _Optional[_Union[CellsChunk, _Mapping]] = ..., chunk: _Optional[_Union[Chunk, _Mapping]] = ..., done: _Optional[_Union[RvdDone, _Mapping]] = ...) -> None: ...

class CvtHeader(_message.Message):
    __slots__ = ("mesh", "seeds", "backend", "options")
    MESH_FIELD_NUMBER: _ClassVar[int]
    SEEDS_FIELD_NUMBER: _ClassVar[int]
    BACKEND_FIELD_NUMBER: _ClassVar[int]
    OPTIONS_FIELD_NUMBER: _ClassVar[int]
    mesh: MeshHeader
    seeds: int
    backend: BackendChoice
    options: CvtOptions
    def __init__(self, mesh: _Optional[_Union[MeshHeader, _Mapping]] = ..., seeds: _Optional[int] = ..., backend: _Optional[_Union[BackendChoice, str]] = ..., options: _Optional[_Union[CvtOptions, _Mapping]] = ...) -> None: ...

class CvtStart(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class CvtStep(_message.Message):
    __slots__ = ("iterations", "seeds", "kind")
    ITERATIONS_FIELD_NUMBER: _ClassVar[int]
    SEEDS_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    iterations: int
    seeds: SeedsWanted
    kind: StepKind
    def __init__(self, iterations: _Optional[int] = ..., seeds: _Optional[_Union[SeedsWanted, str]] = ..., kind: _Optional[_Union[StepKind, str]] = ...) -> None: ...

class Point(_message.Message):
    __slots__ = ("x", "y", "z")
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    Z_FIELD_NUMBER: _ClassVar[int]
    x: float
    y: float
    z: float
    def __init__(self, x: _Optional[float] = ..., y: _Optional[float] = ..., z: _Optional[float] = ...) -> None: ...

class MoveSeed(_message.Message):
    __slots__ = ("index", "to")
    INDEX_FIELD_NUMBER: _ClassVar[int]
    TO_FIELD_NUMBER: _ClassVar[int]
    index: int
    to: Point
    def __init__(self, index: _Optional[int] = ..., to: _Optional[_Union[Point, _Mapping]] = ...) -> None: ...

class SeedEdit(_message.Message):
    __slots__ = ("move", "add", "remove")
    MOVE_FIELD_NUMBER: _ClassVar[int]
    ADD_FIELD_NUMBER: _ClassVar[int]
    REMOVE_FIELD_NUMBER: _ClassVar[int]
    move: MoveSeed
    add: Point
    remove: int
    def __init__(self, move: _Optional[_Union[MoveSeed, _Mapping]] = ..., add: _Optional[_Union[Point, _Mapping]] = ..., remove: _Optional[int] = ...) -> None: ...

class CvtEdit(_message.Message):
    __slots__ = ("edits", "seeds")
    EDITS_FIELD_NUMBER: _ClassVar[int]
    SEEDS_FIELD_NUMBER: _ClassVar[int]
    edits: _containers.RepeatedCompositeFieldContainer[SeedEdit]
    seeds: SeedsWanted
    def __init__(self, edits: _Optional[_Iterable[_Union[SeedEdit, _Mapping]]] = ..., seeds: _Optional[_Union[SeedsWanted, str]] = ...) -> None: ...

class CvtRequest(_message.Message):
    __slots__ = ("header", "chunk", "start", "step", "edit", "finish")
    HEADER_FIELD_NUMBER: _ClassVar[int]
    CHUNK_FIELD_NUMBER: _ClassVar[int]
    START_FIELD_NUMBER: _ClassVar[int]
    STEP_FIELD_NUMBER: _ClassVar[int]
    EDIT_FIELD_NUMBER: _ClassVar[int]
    FINISH_FIELD_NUMBER: _ClassVar[int]
    header: CvtHeader
    chunk: Chunk
    start: CvtStart
    step: CvtStep
    edit: CvtEdit
    finish: Finish
    def __init__(self, header: _Optional[_Union[CvtHeader, _Mapping]] = ..., chunk: _Optional[_Union[Chunk, _Mapping]] = ..., start: _Optional[_Union[CvtStart, _Mapping]] = ..., step: _Optional[_Union[CvtStep, _Mapping]] = ..., edit: _Optional[_Union[CvtEdit, _Mapping]] = ..., finish: _Optional[_Union[Finish, _Mapping]] = ...) -> None: ...

class CvtEdited(_message.Message):
    __slots__ = ("seeds",)
    SEEDS_FIELD_NUMBER: _ClassVar[int]
    seeds: int
    def __init__(self, seeds: _Optional[int] = ...) -> None: ...

class CvtDone(_message.Message):
    __slots__ = ("backend", "adapter", "timing", "iterations", "seeds")
    BACKEND_FIELD_NUMBER: _ClassVar[int]
    ADAPTER_FIELD_NUMBER: _ClassVar[int]
    TIMING_FIELD_NUMBER: _ClassVar[int]
    ITERATIONS_FIELD_NUMBER: _ClassVar[int]
    SEEDS_FIELD_NUMBER: _ClassVar[int]
    backend: str
    adapter: str
    timing: Timing
    iterations: int
    seeds: int
    def __init__(self, backend: _Optional[str] = ..., adapter: _Optional[str] = ..., timing: _Optional[_Union[Timing, _Mapping]] = ..., iterations: _Optional[int] = ..., seeds: _Optional[int] = ...) -> None: ...

class CvtResponse(_message.Message):
    __slots__ = ("accepted", "progress", "iteration", "chunk", "edited", "done")
    ACCEPTED_FIELD_NUMBER: _ClassVar[int]
    PROGRESS_FIELD_NUMBER: _ClassVar[int]
    ITERATION_FIELD_NUMBER: _ClassVar[int]
    CHUNK_FIELD_NUMBER: _ClassVar[int]
    EDITED_FIELD_NUMBER: _ClassVar[int]
    DONE_FIELD_NUMBER: _ClassVar[int]
    accepted: Accepted
    progress: Progress
    iteration: Iteration
    chunk: Chunk
    edited: CvtEdited
    done: CvtDone
    def __init__(self, accepted: _Optional[_Union[Accepted, _Mapping]] = ..., progress: _Optional[_Union[Progress, _Mapping]] = ..., iteration: _Optional[_Union[Iteration, _Mapping]] = ..., chunk: _Optional[_Union[Chunk, _Mapping]] = ..., edited: _Optional[_Union[CvtEdited, _Mapping]] = ..., done: _Optional[_Union[CvtDone, _Mapping]] = ...) -> None: ...

class RemeshHeader(_message.Message):
    __slots__ = ("mesh", "seeds", "backend", "options")
    MESH_FIELD_NUMBER: _ClassVar[int]
    SEEDS_FIELD_NUMBER: _ClassVar[int]
    BACKEND_FIELD_NUMBER: _ClassVar[int]
    OPTIONS_FIELD_NUMBER: _ClassVar[int]
    mesh: MeshHeader
    seeds: int
    backend: BackendChoice
    options: RemeshOptions
    def __init__(self, mesh: _Optional[_Union[MeshHeader, _Mapping]] = ..., seeds: _Optional[int] = ..., backend: _Optional[_Union[BackendChoice, str]] = ..., options: _Optional[_Union[RemeshOptions, _Mapping]] = ...) -> None: ...

class RemeshRequest(_message.Message):
    __slots__ = ("header", "chunk", "finish")
    HEADER_FIELD_NUMBER: _ClassVar[int]
    CHUNK_FIELD_NUMBER: _ClassVar[int]
    FINISH_FIELD_NUMBER: _ClassVar[int]
    header: RemeshHeader
    chunk: Chunk
    finish: Finish
    def __init__(self, header: _Optional[_Union[RemeshHeader, _Mapping]] = ..., chunk: _Optional[_Union[Chunk, _Mapping]] = ..., finish: _Optional[_Union[Finish, _Mapping]] = ...) -> None: ...

class Warning(_message.Message):
    __slots__ = ("code", "message", "count", "places")
    CODE_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    COUNT_FIELD_NUMBER: _ClassVar[int]
    PLACES_FIELD_NUMBER: _ClassVar[int]
    code: str
    message: str
    count: int
    places: _containers.RepeatedCompositeFieldContainer[Point]
    def __init__(self, code: _Optional[str] = ..., message: _Optional[str] = ..., count: _Optional[int] = ..., places: _Optional[_Iterable[_Union[Point, _Mapping]]] = ...) -> None: ...

class RemeshDone(_message.Message):
    __slots__ = ("backend", "adapter", "timing", "vertices", "facets", "seeds", "converged", "figures", "report_json", "topology_changes", "refinement_end", "warnings", "attributes")
    BACKEND_FIELD_NUMBER: _ClassVar[int]
    ADAPTER_FIELD_NUMBER: _ClassVar[int]
    TIMING_FIELD_NUMBER: _ClassVar[int]
    VERTICES_FIELD_NUMBER: _ClassVar[int]
    FACETS_FIELD_NUMBER: _ClassVar[int]
    SEEDS_FIELD_NUMBER: _ClassVar[int]
    CONVERGED_FIELD_NUMBER: _ClassVar[int]
    FIGURES_FIELD_NUMBER: _ClassVar[int]
    REPORT_JSON_FIELD_NUMBER: _ClassVar[int]
    TOPOLOGY_CHANGES_FIELD_NUMBER: _ClassVar[int]
    REFINEMENT_END_FIELD_NUMBER: _ClassVar[int]
    WARNINGS_FIELD_NUMBER: _ClassVar[int]
    ATTRIBUTES_FIELD_NUMBER: _ClassVar[int]
    backend: str
    adapter: str
    timing: Timing
    vertices: int
    facets: int
    seeds: int
    converged: bool
    figures: RvdFigures
    report_json: str
    topology_changes: _containers.RepeatedScalarFieldContainer[str]
    refinement_end: RefinementEnd
    warnings: _containers.RepeatedCompositeFieldContainer[Warning]
    attributes: _containers.RepeatedCompositeFieldContainer[AttributeHeader]
    def __init__(self, backend: _Optional[str] = ..., adapter: _Optional[str] = ..., timing: _Optional[_Union[Timing, _Mapping]] = ..., vertices: _Optional[int] = ..., facets: _Optional[int] = ..., seeds: _Optional[int] = ..., converged: bool = ..., figures: _Optional[_Union[RvdFigures, _Mapping]] = ..., report_json: _Optional[str] = ..., topology_changes: _Optional[_Iterable[str]] = ..., refinement_end: _Optional[_Union[RefinementEnd, str]] = ..., warnings: _Optional[_Iterable[_Union[Warning, _Mapping]]] = ..., attributes: _Optional[_Iterable[_Union[AttributeHeader, _Mapping]]] = ...) -> None: ...

class RemeshResponse(_message.Message):
    __slots__ = ("accepted", "progress", "iteration", "chunk", "done")
    ACCEPTED_FIELD_NUMBER: _ClassVar[int]
    PROGRESS_FIELD_NUMBER: _ClassVar[int]
    ITERATION_FIELD_NUMBER: _ClassVar[int]
    CHUNK_FIELD_NUMBER: _ClassVar[int]
    DONE_FIELD_NUMBER: _ClassVar[int]
    accepted: Accepted
    progress: Progress
    iteration: Iteration
    chunk: Chunk
    done: RemeshDone
    def __init__(self, accepted: _Optional[_Union[Accepted, _Mapping]] = ..., progress: _Optional[_Union[Progress, _Mapping]] = ..., iteration: _Optional[_Union[Iteration, _Mapping]] = ..., chunk: _Optional[_Union[Chunk, _Mapping]] = ..., done: _Optional[_Union[RemeshDone, _Mapping]] = ...) -> None: ...
