"""What accuracy costs on the scene of the page, in the light of its knobs: `radwrap trade` as a job of the page."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.extras import require
from radwrap.imaging.render_options import RenderOptions
from radwrap.manifest import plain
from radwrap.study.trade_rows import TradeOptions
from radwrap.units import TIME, parse_quantity

_LETTERS: Final = 40


def longest_of(told: Any) -> float:
    """Time of a setting that a page names, such as "10 s"; a setting that is expected to take longer is left out [s].

    Raises
    ------
    InputError
        If it is no time, or none that a trade takes.
    """
    if not isinstance(told, str) or len(told) > _LETTERS:
        raise InputError('must be a time with its unit, such as "10 s"', where="longest")
    try:
        found = parse_quantity(told.strip(), TIME)
    except InputError as error:
        raise InputError(error.what, where="longest", remedy=error.remedy) from error
    return TradeOptions(longest=found).longest


def measured_trade(
    request: Mapping[str, Any], cancelled: Callable[[], bool], tell: Callable[[Mapping[str, Any]], object]
) -> dict[str, Any]:
    """Sweep methods and settings on a scene; in the process that traces.

    Parameters
    ----------
    request : Mapping
        ``scene``, ``options`` of `RenderOptions`, ``longest`` [s], ``out``: the folder where finished settings wait,
        ``keeps``: whether table, numbers and picture are written there.
    cancelled : callable
        Whether it is to end.
    tell : callable
        Is told ``progress``: ``what`` is done, ``done`` and ``of``.

    Returns
    -------
    dict
        ``tolerance``, ``reference`` [gray level], ``settings``: ``options``, ``rays``, ``wall_s``, ``rms_gray`` and
        ``rms_gray_upper`` of each, and whether it is on the ``front``; ``left_out``, ``recommendation``: see
        `measure_trade`.

    Raises
    ------
    InputError, TracerError, EnvironmentFailure, Cancelled
        As `measure_trade`.
    """
    require("study", "trade")
    from radwrap.study.trade import measure_trade
    from radwrap.study.trade_report import pareto_front, recommendation, write_trade

    scene = request["scene"]
    options = TradeOptions(longest=request["longest"], render=RenderOptions(**request["options"]))
    out = Path(request["out"])
    trade = measure_trade(
        scene,
        out,
        options,
        cancelled=cancelled,
        told=lambda what, state: tell({"progress": {"what": what, **asdict(state)}}),
    )
    if request["keeps"]:
        write_trade(trade, out)
    front = {row.setting.name for row in pareto_front(trade.rows)}
    told = {
        "tolerance": trade.tolerance,
        "reference": trade.reference.rms_gray,
        "settings": [
            {
                "options": row.setting.options,
                "rays": row.rays,
                "wall_s": row.wall_s,
                "rms_gray": row.error.rms_gray,
                "rms_gray_upper": row.error.rms_gray_upper,
                "front": row.setting.name in front,
            }
            for row in trade.rows
        ],
        "left_out": [{"options": left.setting.options, "why": left.why} for left in trade.left_out],
        "recommendation": recommendation(trade.rows, trade.tolerance),
    }
    plainly: dict[str, Any] = plain(told)
    return plainly
