import datetime

from google.protobuf import duration_pb2 as _duration_pb2
from google.protobuf import timestamp_pb2 as _timestamp_pb2
from . import remesh_pb2 as _remesh_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class JobState(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    JOB_STATE_UNSPECIFIED: _ClassVar[JobState]
    JOB_STATE_QUEUED: _ClassVar[JobState]
    JOB_STATE_RUNNING: _ClassVar[JobState]
    JOB_STATE_SUCCEEDED: _ClassVar[JobState]
    JOB_STATE_FAILED: _ClassVar[JobState]
    JOB_STATE_CANCELLED: _ClassVar[JobState]
    JOB_STATE_EXPIRED: _ClassVar[JobState]

class MeshFormat(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    MESH_FORMAT_UNSPECIFIED: _ClassVar[MeshFormat]
    MESH_FORMAT_PLY: _ClassVar[MeshFormat]
    MESH_FORMAT_OBJ: _ClassVar[MeshFormat]
    MESH_FORMAT_STL: _ClassVar[MeshFormat]
    MESH_FORMAT_OFF: _ClassVar[MeshFormat]
    MESH_FORMAT_VTK: _ClassVar[MeshFormat]
    MESH_FORMAT_VTP: _ClassVar[MeshFormat]
    MESH_FORMAT_MSH: _ClassVar[MeshFormat]
    MESH_FORMAT_MESH: _ClassVar[MeshFormat]
    MESH_FORMAT_MESHB: _ClassVar[MeshFormat]
    MESH_FORMAT_GLB: _ClassVar[MeshFormat]
    MESH_FORMAT_GLTF: _ClassVar[MeshFormat]
    MESH_FORMAT_VTU: _ClassVar[MeshFormat]
    MESH_FORMAT_3MF: _ClassVar[MeshFormat]

class ArrayForm(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    ARRAY_FORM_UNSPECIFIED: _ClassVar[ArrayForm]
    ARRAY_FORM_F32: _ClassVar[ArrayForm]
    ARRAY_FORM_F64: _ClassVar[ArrayForm]
    ARRAY_FORM_U32: _ClassVar[ArrayForm]
    ARRAY_FORM_U8: _ClassVar[ArrayForm]
    ARRAY_FORM_TEXT: _ClassVar[ArrayForm]
    ARRAY_FORM_I8: _ClassVar[ArrayForm]
    ARRAY_FORM_U16: _ClassVar[ArrayForm]
    ARRAY_FORM_I16: _ClassVar[ArrayForm]
    ARRAY_FORM_I32: _ClassVar[ArrayForm]
    ARRAY_FORM_U64: _ClassVar[ArrayForm]
    ARRAY_FORM_I64: _ClassVar[ArrayForm]

class ReusePolicy(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    REUSE_POLICY_UNSPECIFIED: _ClassVar[ReusePolicy]
    REUSE_POLICY_NEVER: _ClassVar[ReusePolicy]
    REUSE_POLICY_SAME_BITS: _ClassVar[ReusePolicy]

class JobFailureKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    JOB_FAILURE_KIND_UNSPECIFIED: _ClassVar[JobFailureKind]
    JOB_FAILURE_KIND_BAD_INPUT: _ClassVar[JobFailureKind]
    JOB_FAILURE_KIND_MISSING_INPUT: _ClassVar[JobFailureKind]
    JOB_FAILURE_KIND_TOO_LARGE: _ClassVar[JobFailureKind]
    JOB_FAILURE_KIND_UNAVAILABLE: _ClassVar[JobFailureKind]
    JOB_FAILURE_KIND_CRASHED: _ClassVar[JobFailureKind]
    JOB_FAILURE_KIND_INTERNAL: _ClassVar[JobFailureKind]
JOB_STATE_UNSPECIFIED: JobState
JOB_STATE_QUEUED: JobState
JOB_STATE_RUNNING: JobState
JOB_STATE_SUCCEEDED: JobState
JOB_STATE_FAILED: JobState
JOB_STATE_CANCELLED: JobState
JOB_STATE_EXPIRED: JobState
MESH_FORMAT_UNSPECIFIED: MeshFormat
MESH_FORMAT_PLY: MeshFormat
MESH_FORMAT_OBJ: MeshFormat
MESH_FORMAT_STL: MeshFormat
MESH_FORMAT_OFF: MeshFormat
MESH_FORMAT_VTK: MeshFormat
MESH_FORMAT_VTP: MeshFormat
MESH_FORMAT_MSH: MeshFormat
MESH_FORMAT_MESH: MeshFormat
MESH_FORMAT_MESHB: MeshFormat
MESH_FORMAT_GLB: MeshFormat
MESH_FORMAT_GLTF: MeshFormat
MESH_FORMAT_VTU: MeshFormat
MESH_FORMAT_3MF: MeshFormat
ARRAY_FORM_UNSPECIFIED: ArrayForm
ARRAY_FORM_F32: ArrayForm
ARRAY_FORM_F64: ArrayForm
ARRAY_FORM_U32: ArrayForm
ARRAY_FORM_U8: ArrayForm
ARRAY_FORM_TEXT: ArrayForm
ARRAY_FORM_I8: ArrayForm
ARRAY_FORM_U16: ArrayForm
ARRAY_FORM_I16: ArrayForm
ARRAY_FORM_I32: ArrayForm
ARRAY_FORM_U64: ArrayForm
ARRAY_FORM_I64: ArrayForm
REUSE_POLICY_UNSPECIFIED: ReusePolicy
REUSE_POLICY_NEVER: ReusePolicy
REUSE_POLICY_SAME_BITS: ReusePolicy
JOB_FAILURE_KIND_UNSPECIFIED: JobFailureKind
JOB_FAILURE_KIND_BAD_INPUT: JobFailureKind
JOB_FAILURE_KIND_MISSING_INPUT: JobFailureKind
JOB_FAILURE_KIND_TOO_LARGE: JobFailureKind
JOB_FAILURE_KIND_UNAVAILABLE: JobFailureKind
JOB_FAILURE_KIND_CRASHED: JobFailureKind
JOB_FAILURE_KIND_INTERNAL: JobFailureKind

class ArrayRef(_message.Message):
    __slots__ = ("digest", "form", "count")
    DIGEST_FIELD_NUMBER: _ClassVar[int]
    FORM_FIELD_NUMBER: _ClassVar[int]
    COUNT_FIELD_NUMBER: _ClassVar[int]
    digest: str
    form: ArrayForm
    count: int
    def __init__(self, digest: _Optional[str] = ..., form: _Optional[_Union[ArrayForm, str]] = ..., count: _Optional[int] = ...) -> None: ...

class MeshFile(_message.Message):
    __slots__ = ("digest", "format", "attributes")
    DIGEST_FIELD_NUMBER: _ClassVar[int]
    FORMAT_FIELD_NUMBER: _ClassVar[int]
    ATTRIBUTES_FIELD_NUMBER: _ClassVar[int]
    digest: str
    format: MeshFormat
    attributes: bool
    def __init__(self, digest: _Optional[str] = ..., format: _Optional[_Union[MeshFormat, str]] = ..., attributes: bool = ...) -> None: ...

class AttributeArrays(_message.Message):
    __slots__ = ("kind", "name", "values", "corners", "components", "regions")
    KIND_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    VALUES_FIELD_NUMBER: _ClassVar[int]
    CORNERS_FIELD_NUMBER: _ClassVar[int]
    COMPONENTS_FIELD_NUMBER: _ClassVar[int]
    REGIONS_FIELD_NUMBER: _ClassVar[int]
    kind: _remesh_pb2.AttributeKind
    name: str
    values: ArrayRef
    corners: ArrayRef
    components: int
    regions: _containers.RepeatedCompositeFieldContainer[_remesh_pb2.Region]
    def __init__(self, kind: _Optional[_Union[_remesh_pb2.AttributeKind, str]] = ..., name: _Optional[str] = ..., values: _Optional[_Union[ArrayRef, _Mapping]] = ..., corners: _Optional[_Union[ArrayRef, _Mapping]] = ..., components: _Optional[int] = ..., regions: _Optional[_Iterable[_Union[_remesh_pb2.Region, _Mapping]]] = ...) -> None: ...

class MeshArrays(_message.Message):
    __slots__ = ("positions", "facets", "attributes")
    POSITIONS_FIELD_NUMBER: _ClassVar[int]
    FACETS_FIELD_NUMBER: _ClassVar[int]
    ATTRIBUTES_FIELD_NUMBER: _ClassVar[int]
    positions: ArrayRef
    facets: ArrayRef
    attributes: _containers.RepeatedCompositeFieldContainer[AttributeArrays]
    def __init__(self, positions: _Optional[_Union[ArrayRef, _Mapping]] = ..., facets: _Optional[_Union[ArrayRef, _Mapping]] = ..., attributes: _Optional[_Iterable[_Union[AttributeArrays, _Mapping]]] = ...) -> None: ...

class JobMesh(_message.Message):
    __slots__ = ("file", "arrays")
    FILE_FIELD_NUMBER: _ClassVar[int]
    ARRAYS_FIELD_NUMBER: _ClassVar[int]
    file: MeshFile
    arrays: MeshArrays
    def __init__(self, file: _Optional[_Union[MeshFile, _Mapping]] = ..., arrays: _Optional[_Union[MeshArrays, _Mapping]] = ...) -> None: ...

class JobArrays(_message.Message):
    __slots__ = ("seeds", "edge_lengths", "weights", "creases", "metric")
    SEEDS_FIELD_NUMBER: _ClassVar[int]
    EDGE_LENGTHS_FIELD_NUMBER: _ClassVar[int]
    WEIGHTS_FIELD_NUMBER: _ClassVar[int]
    CREASES_FIELD_NUMBER: _ClassVar[int]
    METRIC_FIELD_NUMBER: _ClassVar[int]
    seeds: ArrayRef
    edge_lengths: ArrayRef
    weights: ArrayRef
    creases: ArrayRef
    metric: ArrayRef
    def __init__(self, seeds: _Optional[_Union[ArrayRef, _Mapping]] = ..., edge_lengths: _Optional[_Union[ArrayRef, _Mapping]] = ..., weights: _Optional[_Union[ArrayRef, _Mapping]] = ..., creases: _Optional[_Union[ArrayRef, _Mapping]] = ..., metric: _Optional[_Union[ArrayRef, _Mapping]] = ...) -> None: ...

class CvtJobCommand(_message.Message):
    __slots__ = ("step", "edit")
    STEP_FIELD_NUMBER: _ClassVar[int]
    EDIT_FIELD_NUMBER: _ClassVar[int]
    step: _remesh_pb2.CvtStep
    edit: _remesh_pb2.CvtEdit
    def __init__(self, step: _Optional[_Union[_remesh_pb2.CvtStep, _Mapping]] = ..., edit: _Optional[_Union[_remesh_pb2.CvtEdit, _Mapping]] = ...) -> None: ...

class CvtJob(_message.Message):
    __slots__ = ("options", "commands")
    OPTIONS_FIELD_NUMBER: _ClassVar[int]
    COMMANDS_FIELD_NUMBER: _ClassVar[int]
    options: _remesh_pb2.CvtOptions
    commands: _containers.RepeatedCompositeFieldContainer[CvtJobCommand]
    def __init__(self, options: _Optional[_Union[_remesh_pb2.CvtOptions, _Mapping]] = ..., commands: _Optional[_Iterable[_Union[CvtJobCommand, _Mapping]]] = ...) -> None: ...

class ResultFormat(_message.Message):
    __slots__ = ("file", "arrays")
    FILE_FIELD_NUMBER: _ClassVar[int]
    ARRAYS_FIELD_NUMBER: _ClassVar[int]
    file: MeshFormat
    arrays: bool
    def __init__(self, file: _Optional[_Union[MeshFormat, str]] = ..., arrays: bool = ...) -> None: ...

class JobSpec(_message.Message):
    __slots__ = ("mesh", "remesh", "rvd", "cvt", "backend", "result", "priority", "queue_deadline", "run_deadline", "labels", "arrays")
    class LabelsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: str
        def __init__(self, key: _Optional[str] = ..., value: _Optional[str] = ...) -> None: ...
    MESH_FIELD_NUMBER: _ClassVar[int]
    REMESH_FIELD_NUMBER: _ClassVar[int]
    RVD_FIELD_NUMBER: _ClassVar[int]
    CVT_FIELD_NUMBER: _ClassVar[int]
    BACKEND_FIELD_NUMBER: _ClassVar[int]
    RESULT_FIELD_NUMBER: _ClassVar[int]
    PRIORITY_FIELD_NUMBER: _ClassVar[int]
    QUEUE_DEADLINE_FIELD_NUMBER: _ClassVar[int]
    RUN_DEADLINE_FIELD_NUMBER: _ClassVar[int]
    LABELS_FIELD_NUMBER: _ClassVar[int]
    ARRAYS_FIELD_NUMBER: _ClassVar[int]
    mesh: JobMesh
    remesh: _remesh_pb2.RemeshOptions
    rvd: _remesh_pb2.DiagramOptions
    cvt: CvtJob
    backend: _remesh_pb2.BackendChoice
    result: ResultFormat
    priority: int
    queue_deadline: _duration_pb2.Duration
    run_deadline: _duration_pb2.Duration
    labels: _containers.ScalarMap[str, str]
    arrays: JobArrays
    def __init__(self, mesh: _Optional[_Union[JobMesh, _Mapping]] = ..., remesh: _Optional[_Union[_remesh_pb2.RemeshOptions, _Mapping]] = ..., rvd: _Optional[_Union[_remesh_pb2.DiagramOptions, _Mapping]] = ..., cvt: _Optional[_Union[CvtJob, _Mapping]] = ..., backend: _Optional[_Union[_remesh_pb2.BackendChoice, str]] = ..., result: _Optional[_Union[ResultFormat, _Mapping]] = ..., priority: _Optional[int] = ..., queue_deadline: _Optional[_Union[datetime.timedelta, _duration_pb2.Duration, _Mapping]] = ..., run_deadline: _Optional[_Union[datetime.timedelta, _duration_pb2.Duration, _Mapping]] = ..., labels: _Optional[_Mapping[str, str]] = ..., arrays: _Optional[_Union[JobArrays, _Mapping]] = ...) -> None: ...

class JobFailure(_message.Message):
    __slots__ = ("kind", "message")
    KIND_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    kind: JobFailureKind
    message: str
    def __init__(self, kind: _Optional[_Union[JobFailureKind, str]] = ..., message: _Optional[str] = ...) -> None: ...

class ResultBlob(_message.Message):
    __slots__ = ("name", "digest")
    NAME_FIELD_NUMBER: _ClassVar[int]
    DIGEST_FIELD_NUMBER: _ClassVar[int]
    name: str
    digest: str
    def __init__(self, name: _Optional[str] = ..., digest: _Optional[str] = ...) -> None: ...

class Job(_message.Message):
    __slots__ = ("id", "spec", "state", "created", "started", "changed", "attempts", "crashes", "failure", "results", "expired_by", "request_id", "unschedulable", "server")
    ID_FIELD_NUMBER: _ClassVar[int]
    SPEC_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    CREATED_FIELD_NUMBER: _ClassVar[int]
    STARTED_FIELD_NUMBER: _ClassVar[int]
    CHANGED_FIELD_NUMBER: _ClassVar[int]
    ATTEMPTS_FIELD_NUMBER: _ClassVar[int]
    CRASHES_FIELD_NUMBER: _ClassVar[int]
    FAILURE_FIELD_NUMBER: _ClassVar[int]
    RESULTS_FIELD_NUMBER: _ClassVar[int]
    EXPIRED_BY_FIELD_NUMBER: _ClassVar[int]
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    UNSCHEDULABLE_FIELD_NUMBER: _ClassVar[int]
    SERVER_FIELD_NUMBER: _ClassVar[int]
    id: str
    spec: JobSpec
    state: JobState
    created: _timestamp_pb2.Timestamp
    started: _timestamp_pb2.Timestamp
    changed: _timestamp_pb2.Timestamp
    attempts: int
    crashes: int
    failure: JobFailure
    results: _containers.RepeatedCompositeFieldContainer[ResultBlob]
    expired_by: str
    request_id: str
    unschedulable: str
    server: str
    def __init__(self, id: _Optional[str] = ..., spec: _Optional[_Union[JobSpec, _Mapping]] = ..., state: _Optional[_Union[JobState, str]] = ..., created: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., started: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., changed: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., attempts: _Optional[int] = ..., crashes: _Optional[int] = ..., failure: _Optional[_Union[JobFailure, _Mapping]] = ..., results: _Optional[_Iterable[_Union[ResultBlob, _Mapping]]] = ..., expired_by: _Optional[str] = ..., request_id: _Optional[str] = ..., unschedulable: _Optional[str] = ..., server: _Optional[str] = ...) -> None: ...

class CreateJobRequest(_message.Message):
    __slots__ = ("spec", "request_id", "reuse")
    SPEC_FIELD_NUMBER: _ClassVar[int]
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    REUSE_FIELD_NUMBER: _ClassVar[int]
    spec: JobSpec
    request_id: str
    reuse: ReusePolicy
    def __init__(self, spec: _Optional[_Union[JobSpec, _Mapping]] = ..., request_id: _Optional[str] = ..., reuse: _Optional[_Union[ReusePolicy, str]] = ...) -> None: ...

class CreateJobResponse(_message.Message):
    __slots__ = ("job", "existed", "reused")
    JOB_FIELD_NUMBER: _ClassVar[int]
    EXISTED_FIELD_NUMBER: _ClassVar[int]
    REUSED_FIELD_NUMBER: _ClassVar[int]
    job: Job
    existed: bool
    reused: bool
    def __init__(self, job: _Optional[_Union[Job, _Mapping]] = ..., existed: bool = ..., reused: bool = ...) -> None: ...

class GetJobRequest(_message.Message):
    __slots__ = ("id",)
    ID_FIELD_NUMBER: _ClassVar[int]
    id: str
    def __init__(self, id: _Optional[str] = ...) -> None: ...

class GetJobResponse(_message.Message):
    __slots__ = ("job",)
    JOB_FIELD_NUMBER: _ClassVar[int]
    job: Job
    def __init__(self, job: _Optional[_Union[Job, _Mapping]] = ...) -> None: ...

class ListJobsRequest(_message.Message):
    __slots__ = ("page_size", "page_token", "states", "labels", "created_since", "created_before")
    class LabelsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: str
        def __init__(self, key: _Optional[str] = ..., value: _Optional[str] = ...) -> None: ...
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    STATES_FIELD_NUMBER: _ClassVar[int]
    LABELS_FIELD_NUMBER: _ClassVar[int]
    CREATED_SINCE_FIELD_NUMBER: _ClassVar[int]
    CREATED_BEFORE_FIELD_NUMBER: _ClassVar[int]
    page_size: int
    page_token: str
    states: _containers.RepeatedScalarFieldContainer[JobState]
    labels: _containers.ScalarMap[str, str]
    created_since: _timestamp_pb2.Timestamp
    created_before: _timestamp_pb2.Timestamp
    def __init__(self, page_size: _Optional[int] = ..., page_token: _Optional[str] = ..., states: _Optional[_Iterable[_Union[JobState, str]]] = ..., labels: _Optional[_Mapping[str, str]] = ..., created_since: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., created_before: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ...) -> None: ...

class ListJobsResponse(_message.Message):
    __slots__ = ("jobs", "next_page_token")
    JOBS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    jobs: _containers.RepeatedCompositeFieldContainer[Job]
    next_page_token: str
    def __init__(self, jobs: _Optional[_Iterable[_Union[Job, _Mapping]]] = ..., next_page_token: _Optional[str] = ...) -> None: ...

class WatchJobRequest(_message.Message):
    __slots__ = ("id", "after")
    ID_FIELD_NUMBER: _ClassVar[int]
    AFTER_FIELD_NUMBER: _ClassVar[int]
    id: str
    after: int
    def __init__(self, id: _Optional[str] = ..., after: _Optional[int] = ...) -> None: ...

class JobStateChange(_message.Message):
    __slots__ = ("state", "attempt")
    STATE_FIELD_NUMBER: _ClassVar[int]
    ATTEMPT_FIELD_NUMBER: _ClassVar[int]
    state: JobState
    attempt: int
    def __init__(self, state: _Optional[_Union[JobState, str]] = ..., attempt: _Optional[int] = ...) -> None: ...

class JobStage(_message.Message):
    __slots__ = ("name", "done", "total")
    NAME_FIELD_NUMBER: _ClassVar[int]
    DONE_FIELD_NUMBER: _ClassVar[int]
    TOTAL_FIELD_NUMBER: _ClassVar[int]
    name: str
    done: int
    total: int
    def __init__(self, name: _Optional[str] = ..., done: _Optional[int] = ..., total: _Optional[int] = ...) -> None: ...

class JobIteration(_message.Message):
    __slots__ = ("index", "total", "kind", "energy", "gradient_norm", "ms", "energy_ratio")
    INDEX_FIELD_NUMBER: _ClassVar[int]
    TOTAL_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    ENERGY_FIELD_NUMBER: _ClassVar[int]
    GRADIENT_NORM_FIELD_NUMBER: _ClassVar[int]
    MS_FIELD_NUMBER: _ClassVar[int]
    ENERGY_RATIO_FIELD_NUMBER: _ClassVar[int]
    index: int
    total: int
    kind: str
    energy: float
    gradient_norm: float
    ms: float
    energy_ratio: float
    def __init__(self, index: _Optional[int] = ..., total: _Optional[int] = ..., kind: _Optional[str] = ..., energy: _Optional[float] = ..., gradient_norm: _Optional[float] = ..., ms: _Optional[float] = ..., energy_ratio: _Optional[float] = ...) -> None: ...

class JobEvent(_message.Message):
    __slots__ = ("number", "at", "state", "stage", "iteration")
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    AT_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    STAGE_FIELD_NUMBER: _ClassVar[int]
    ITERATION_FIELD_NUMBER: _ClassVar[int]
    number: int
    at: _timestamp_pb2.Timestamp
    state: JobStateChange
    stage: JobStage
    iteration: JobIteration
    def __init__(self, number: _Optional[int] = ..., at: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., state: _Optional[_Union[JobStateChange, _Mapping]] = ..., stage: _Optional[_Union[JobStage, _Mapping]] = ..., iteration: _Optional[_Union[JobIteration, _Mapping]] = ...) -> None: ...

class WatchJobResponse(_message.Message):
    __slots__ = ("event",)
    EVENT_FIELD_NUMBER: _ClassVar[int]
    event: JobEvent
    def __init__(self, event: _Optional[_Union[JobEvent, _Mapping]] = ...) -> None: ...

class CancelJobRequest(_message.Message):
    __slots__ = ("id",)
    ID_FIELD_NUMBER: _ClassVar[int]
    id: str
    def __init__(self, id: _Optional[str] = ...) -> None: ...

class CancelJobResponse(_message.Message):
    __slots__ = ("job",)
    JOB_FIELD_NUMBER: _ClassVar[int]
    job: Job
    def __init__(self, job: _Optional[_Union[Job, _Mapping]] = ...) -> None: ...

class DeleteJobRequest(_message.Message):
    __slots__ = ("id",)
    ID_FIELD_NUMBER: _ClassVar[int]
    id: str
    def __init__(self, id: _Optional[str] = ...) -> None: ...

class DeleteJobResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class EstimateJobRequest(_message.Message):
    __slots__ = ("spec", "vertices", "facets")
    SPEC_FIELD_NUMBER: _ClassVar[int]
    VERTICES_FIELD_NUMBER: _ClassVar[int]
    FACETS_FIELD_NUMBER: _ClassVar[int]
    spec: JobSpec
    vertices: int
    facets: int
    def __init__(self, spec: _Optional[_Union[JobSpec, _Mapping]] = ..., vertices: _Optional[int] = ..., facets: _Optional[int] = ...) -> None: ...

class EstimateJobResponse(_message.Message):
    __slots__ = ("host_bytes", "host_limit_bytes", "device_bytes", "device_limit_bytes", "seconds", "fits", "unschedulable")
    HOST_BYTES_FIELD_NUMBER: _ClassVar[int]
    HOST_LIMIT_BYTES_FIELD_NUMBER: _ClassVar[int]
    DEVICE_BYTES_FIELD_NUMBER: _ClassVar[int]
    DEVICE_LIMIT_BYTES_FIELD_NUMBER: _ClassVar[int]
    SECONDS_FIELD_NUMBER: _ClassVar[int]
    FITS_FIELD_NUMBER: _ClassVar[int]
    UNSCHEDULABLE_FIELD_NUMBER: _ClassVar[int]
    host_bytes: int
    host_limit_bytes: int
    device_bytes: int
    device_limit_bytes: int
    seconds: float
    fits: bool
    unschedulable: str
    def __init__(self, host_bytes: _Optional[int] = ..., host_limit_bytes: _Optional[int] = ..., device_bytes: _Optional[int] = ..., device_limit_bytes: _Optional[int] = ..., seconds: _Optional[float] = ..., fits: bool = ..., unschedulable: _Optional[str] = ...) -> None: ...
