"""How far a call is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Union


@dataclass(frozen=True)
class Progress:
    """What a progress callback hears: a stage began, or a step was taken."""

    #: "prepare", "sample", "iterations", "dual", "repair", "attributes", "measure"; from a server also "queue" and "transfer".
    stage: str
    #: Steps taken; None where a stage begins.
    step: int | None = None
    #: Steps planned; a test of convergence may end them earlier.
    steps: int | None = None
    #: Energy of the seeds before the step.
    energy: float | None = None


#: Called with each `Progress`; True shows a bar of tqdm (`pip install tessera-remesh[progress]`).
ProgressLike = Union[Callable[[Progress], object], bool, None]

Engine = Callable[[str, Union[int, None], Union[int, None], Union[float, None]], object]


@contextmanager
def listener(progress: ProgressLike) -> Iterator[Engine | None]:
    """What the engine calls."""
    if progress is None or progress is False:
        yield None
    elif progress is True:
        from tqdm.auto import tqdm

        with tqdm(unit="step", leave=False) as bar:
            yield _Bar(bar)
    else:
        call = progress
        yield lambda stage, step, steps, energy: call(Progress(stage, step, steps, energy))


class _Bar:
    def __init__(self, bar: Any) -> None:
        self.bar = bar

    def __call__(self, stage: str, step: int | None, steps: int | None, energy: float | None) -> None:
        self.bar.set_description(stage)
        if step is not None:
            self.bar.total = steps
            self.bar.n = step
            self.bar.refresh()
