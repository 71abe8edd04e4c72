"""Courses side by side: what each asks for is computed for all that ask at once, in lanes, and what it is told does
not depend on who else asks.

A course is a generator that yields asks and is sent their answers; an answer that is an exception is raised there.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from orbitfinder._runtime import limit
from orbitfinder.errors import IntegrationError, LimitError
from orbitfinder.loops.loop import Equations, Unknowns

Result = TypeVar("Result")


class Ask:
    """What a course waits for."""

    @classmethod
    def answered(cls, asks: Sequence[Any]) -> Sequence[Any]:
        """The answers to asks of this kind; an exception is meant for its course alone."""
        raise NotImplementedError


Course = Generator[Ask, Any, Result]


@dataclass(frozen=True)
class Marched(Ask):
    """What a march says of the unknowns w: the ends of segments (N x d), the states at the whole mesh (M + 1 x d), or
    state-transition matrices (N x d x d). `IntegrationError` where it leaves the numbers."""

    equations: Equations
    w: Unknowns
    what: str = "ends"

    @classmethod
    def answered(cls, asks: Sequence[Marched]) -> Sequence[Any]:
        """All of a kind by the same march together."""
        answers: dict[int, Any] = {}
        groups = defaultdict[tuple[int, str], list[int]](list)
        for k, ask in enumerate(asks):
            groups[id(ask.equations.march), ask.what].append(k)
        for (_, what), numbers in groups.items():
            march, places = asks[numbers[0]].equations.march.arcs[0], [asks[k].w for k in numbers]
            size, varied, whole = march.size, what == "transitions", what == "states"
            loops = [(w.nodes, w.mesh, w.tail) for w in places]
            ends, path = march.beside(varied, loops, (1 + size) * whole)
            counts = [w.mesh.size - 1 if whole else len(w.nodes) for w in places]
            each = np.split((path if whole else ends)[:, 1:], np.cumsum(counts)[:-1])
            for k, w, result in zip(numbers, places, each, strict=True):
                if not np.isfinite(result).all():
                    answers[k] = IntegrationError("the state is not finite", state=w.nodes[0])
                elif varied:
                    answers[k] = result[:, size : size * (1 + size)].reshape(-1, size, size).swapaxes(1, 2)
                else:
                    answers[k] = np.vstack([w.nodes[:1], result]) if whole else result[:, :size]
        return [answers[k] for k in range(len(asks))]


def abreast(courses: Sequence[Course[Result]]) -> list[Result | Exception]:
    """What courses end with, or the exceptions that end them; none is disturbed by another's."""
    ended: dict[int, Result | Exception] = {}
    answers: dict[int, Any] = dict.fromkeys(range(len(courses)))
    while answers:
        asks: dict[int, Ask] = {}
        for k, answer in answers.items():
            limit.check()
            try:
                raised = isinstance(answer, Exception)
                asks[k] = courses[k].throw(answer) if raised else courses[k].send(answer)
            except StopIteration as end:
                ended[k] = end.value
            except LimitError:
                raise
            except Exception as error:  # it is told to whoever asked for this course
                ended[k] = error
        answers = {}
        for kind in {type(ask): None for ask in asks.values()}:
            numbers = [k for k, ask in asks.items() if type(ask) is kind]
            answers |= zip(numbers, kind.answered([asks[k] for k in numbers]), strict=True)
    return [ended[k] for k in range(len(courses))]


def done(result: Result) -> Course[Result]:
    """A course that ends at once."""
    yield from ()
    return result


def alone(course: Course[Result]) -> Result:
    """What a course ends with."""
    (result,) = abreast([course])
    if isinstance(result, Exception):
        raise result
    return result
