"""Which candidates a search looks at next: all of them where they are few, else as optuna's TPE asks.

TPE knows nothing but what it was told, and in which order. Candidates are asked for in batches of one size and told in
their order, so that a seed gives the same search whatever the number of workers.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice, product
from typing import Any, Final, Protocol

from radwrap.designing.keys import Code, SearchKey
from radwrap.extras import require

_RANDOM_BATCHES: Final = 1  # before TPE has anything to go by

Codes = tuple[Code, ...]


class Asker(Protocol):
    """Whoever proposes candidates."""

    def ask(self, count: int) -> list[Codes]:
        """The next candidates, fewer or none where there are no more."""

    def tell(self, values: Sequence[float] | None, violations: Sequence[float]) -> None:
        """What the next of the asked candidates came to: objectives, None where it has none, and broken limits."""


class AllOf:
    """Every combination of choices, the last key fastest."""

    def __init__(self, keys: Sequence[SearchKey]) -> None:
        self._left: Iterator[Codes] = product(*(range(len(key.choices)) for key in keys))

    def ask(self, count: int) -> list[Codes]:
        """The next combinations."""
        return list(islice(self._left, count))

    def tell(self, values: Sequence[float] | None, violations: Sequence[float]) -> None:
        """Nothing hangs on it."""


class Tpe:
    """Optuna's tree-structured Parzen estimator, with limits.

    Parameters
    ----------
    keys : sequence of SearchKey
        What is searched.
    maximised : sequence of bool
        Of each objective.
    seed, batch : int
        Of all that is drawn, and how many are asked for at a time.

    Raises
    ------
    EnvironmentFailure
        If optuna is not installed.
    """

    def __init__(self, keys: Sequence[SearchKey], maximised: Sequence[bool], seed: int, batch: int) -> None:
        require("design", "design")
        import optuna

        optuna.logging.set_verbosity(optuna.logging.ERROR)
        self._spaces = {key.name: _space(optuna, key) for key in keys}
        sampler = optuna.samplers.TPESampler(
            seed=seed,
            n_startup_trials=_RANDOM_BATCHES * batch,
            multivariate=True,
            constant_liar=True,
        )
        kinds = optuna.study.StudyDirection
        directions = [kinds.MAXIMIZE if one else kinds.MINIMIZE for one in maximised]
        self._count = len(directions)
        self._study = optuna.create_study(directions=directions, sampler=sampler)
        self._asked: list[Any] = []

    def ask(self, count: int) -> list[Codes]:
        """What looks best after all that was told."""
        new = [self._study.ask(self._spaces) for _ in range(count)]
        self._asked += new
        return [tuple(trial.params[name] for name in self._spaces) for trial in new]

    def tell(self, values: Sequence[float] | None, violations: Sequence[float]) -> None:
        """The first of those that were asked and not told yet."""
        trial = self._asked.pop(0)
        # What is not known breaks a limit of its own, so that its values do not count.
        for number, violation in enumerate([*violations, float(values is None)]):
            trial.set_constraint(str(number), violation)
        self._study.tell(trial, [0.0] * self._count if values is None else list(values))


def _space(optuna: Any, key: SearchKey) -> Any:
    kinds = optuna.distributions
    if key.span is not None:
        return kinds.FloatDistribution(key.span.low, key.span.high, log=key.span.is_log)
    if key.is_ordered:
        return kinds.IntDistribution(0, len(key.choices) - 1)
    return kinds.CategoricalDistribution(list(range(len(key.choices))))
