"""Draws what a log says: trajectories with the sensing graph (Fig. 4), distances (Fig. 5), error, setpoints.

Pictures, and one page of HTML that has them in it and needs nothing else. What the log does not say (a formation, r, a
common frame) is named as missing in the picture's place. matplotlib is loaded when a report is drawn and not before.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from groundstation.app.flight_picture import Picture
from groundstation.app.paper_figures import PAPER_FIGURES, PAPER_STYLE
from groundstation.app.picture_style import BLUE, INK, LINE, ORANGE, QUIET, RED, SERIES, STYLE
from groundstation.app.pictures import save_picture, source
from groundstation.app.report_facts import Facts, facts_of
from groundstation.app.templates import render
from groundstation.core.errors import UserError
from groundstation.core.own_files import claim, write_whole
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.records.notes import Event, Operator
from groundstation.records.replay import Flight, Phase

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_NEIGHBOURS, _OTHERS = BLUE, ORANGE
_MOST_INSTANTS = 3000
DPI = 100
"""Dots to the inch where nobody says otherwise."""
_PAGE_LOOKED_AT = 1 << 20  # bytes of a page in which its pictures are named
_STYLE: dict[Any, Any] = STYLE | {
    "font.size": 13.0,
    "axes.labelsize": 13.5,
    "xtick.color": INK,
    "ytick.color": INK,
}


def claim_report(folder: Path, *, force: bool, also: Sequence[str] = ()) -> bool:
    """Makes sure that a report may be written into a folder.

    Args:
        folder: need not exist.
        also: further kinds in which its pictures are written.
        force: replace files of its names whatever they are.

    Returns:
        Whether an earlier report is replaced.

    Raises:
        UserError: files of its names are there that are of no report.
    """
    page = folder / "index.html"

    def ours() -> bool:
        with contextlib.suppress(OSError):
            text = page.read_bytes()[:_PAGE_LOOKED_AT]
            return text.startswith(b"<!doctype html>") and all(item.file.encode() in text for item in PICTURES)
        return False

    paths = (page, *(path for item in PICTURES for path in _files(folder, item, also)), *_paper_files(folder, also))
    # each of them is judged before anything is written
    replaced = [claim(path, "the report", "another folder with -o", ours=ours, force=force) for path in paths]
    return any(replaced)


def _files(folder: Path, picture: Picture, also: Sequence[str]) -> list[Path]:
    """A picture's files: the one of the page, and those of further kinds."""
    return [folder / f"{picture.stem}.{kind}" for kind in ("png", *also)]


def _paper_files(folder: Path, also: Sequence[str]) -> list[Path]:
    """Files of the figures at a paper's width; there are some where kinds for papers are wished."""
    return [folder / f"{item.stem}.{kind}" for item in PAPER_FIGURES for kind in also]


def write_report(
    flight: Flight, folder: Path, *, also: Sequence[str] = (), dpi: int = DPI, log: Path | None = None
) -> list[Path]:
    """Draws all pictures and writes the page.

    Args:
        flight: as ``records.replay.load_flight`` reads it.
        also: further kinds in which each picture is written, ``svg`` or ``pdf``; with them come the paper's figures at
            a column's width, see ``paper_figures``.
        dpi: dots to the inch of those that are made of dots.
        folder: created when missing; files of an earlier report are replaced, see ``claim_report``.
        log: that it was read from, for how its links did; None leaves that out.

    Returns:
        The files written, ``index.html`` first.

    Raises:
        UserError: a file cannot be written.
    """
    import matplotlib as mpl  # noqa: PLC0415 - takes a second to load, which no other command should pay
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415
    from matplotlib.figure import Figure  # noqa: PLC0415
    from matplotlib.layout_engine import ConstrainedLayoutEngine  # noqa: PLC0415

    page = folder / "index.html"
    written = [page]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for picture in PICTURES:
            with mpl.rc_context(_STYLE | {"pdf.fonttype": 42}):
                figure = Figure(
                    figsize=picture.size_in, dpi=100, layout=ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.08)
                )
                FigureCanvasAgg(figure)
                picture.draw(figure, flight)
                for file in _files(folder, picture, also):
                    save_picture(figure, file, dpi)
                    written.append(file)
        for file in _paper_files(folder, also):
            item = next(item for item in PAPER_FIGURES if item.stem == file.stem)
            with mpl.rc_context(PAPER_STYLE):
                figure = Figure(figsize=item.size_in, layout=ConstrainedLayoutEngine(w_pad=0.01, h_pad=0.01))
                FigureCanvasAgg(figure)
                item.draw(figure, flight)
                save_picture(figure, file, dpi)
                written.append(file)
        facts = None if log is None else facts_of(flight, log)
        drawn = {item.file: (folder / item.file).read_bytes() for item in PICTURES}
        write_whole(page, to_html(flight, facts, drawn).encode("utf-8"), durable=False)
    except OSError as error:
        raise UserError(
            f"{error.filename or folder}: cannot write the report: {error.strerror or error}; give another folder "
            "with -o"
        ) from error
    return written


def shown_instant(flight: Flight) -> tuple[int, str]:
    """The instant at which the formation is looked at, and words for it.

    The end of the last ``hold``, else of the last ``form``; without such phases the end of the log.
    """
    for name in ("hold", "form"):
        ends = [phase.stop_ns for phase in flight.phases if phase.name == name]
        if ends:
            return ends[-1], f"at the end of {name}"
    return flight.stop_ns, "at the end of the log"


def key_figures(flight: Flight) -> list[tuple[str, str]]:
    """What the page's table says, as (name, value with unit)."""
    instant, words = shown_instant(flight)
    last = _latest_known(flight, instant)
    error = flight.formation_error_at(last)
    figures = [
        ("Vehicles", str(len(flight.vehicles))),
        ("Duration", f"{flight.duration_s:.1f} s"),
        ("Position samples per vehicle, at most", str(flight.samples)),
        ("Velocity setpoints", str(flight.setpoints)),
        ("Ticks", str(flight.ticks) if flight.ticks else "none recorded"),
        ("Smallest distance between reported positions", _metres(flight.min_distance_m())),
        ("Safety radius r", _metres(flight.safety_radius_m)),
        ("Formation", ", ".join(dict.fromkeys(item.name for item in flight.formations)) or "unknown"),
        (f"Formation error {words}", _metres(float(error[0]) if len(error) and np.isfinite(error[0]) else None)),
        ("Changes of role", str(flight.role_changes)),
    ]
    if flight.manifest is not None and flight.manifest.result is not None:
        known = {"outcome": "Outcome", "reason": "Reason", "min_distance_m": "Smallest true distance", "seed": "Seed"}
        for key, name in known.items():
            value = flight.manifest.result.get(key)
            if value is not None:
                figures.append((name, _metres(value) if isinstance(value, float) else str(value)))
    if flight.noise_bytes:
        figures.append(("Received bytes that were no frame", str(flight.noise_bytes)))
    if flight.message is not None:
        figures.append(("Left out", flight.message))
    return figures


def to_html(flight: Flight, facts: Facts | None = None, drawn: Mapping[str, bytes] | None = None) -> str:
    """The page: key figures, pictures, facts, events; no script, no resource from elsewhere.

    Args:
        flight: as read.
        facts: what else is told; None for nothing.
        drawn: pictures that stand in the page itself, by their files' names; those that are not there are looked for
            beside it.
    """
    notes: list[Event | Operator] = sorted([*flight.events, *flight.operator], key=lambda note: note.t_ns)
    return render(
        "flight.html",
        title=flight.name,
        figures=key_figures(flight),
        pictures=PICTURES,
        facts=facts,
        sources={item.file: _source(item.file, (drawn or {}).get(item.file)) for item in PICTURES},
        events=[((note.t_ns - flight.start_ns) / 1e9, note.text) for note in notes],
    )


def _source(file: str, content: bytes | None) -> str:
    """What an image of the page is read from."""
    return file if content is None else source(content)


def _draw_trajectories(figure: Figure, flight: Flight) -> None:
    figure.set_layout_engine("none")  # what reaches out of the square that 3D axes get would be taken for overflow
    axes: Any = figure.add_axes((0.0, 0.095, 1.0, 0.88), projection="3d", computed_zorder=False)
    tracks = [track for track in flight.vehicles if len(track.t_ns)]
    if not tracks:
        _say_missing(figure, "The log holds no positions (LOCAL_POSITION_NED).")
        return
    instant, words = shown_instant(flight)
    final_t = _latest_known(flight, instant)
    final = flight.positions_at(final_t)[0]
    low, high = _box(np.concatenate([track.pos_team_enu_m for track in tracks]))
    low[2] = min(low[2], 0.0)
    colours = _colours(len(flight.vehicles))
    _prepare_box(axes, low, high)
    for track, colour, end in zip(flight.vehicles, colours, final, strict=True):
        path = track.pos_team_enu_m
        if not len(path):
            continue
        until = int(np.searchsorted(track.t_ns, instant, side="right"))
        out, back = path[:until], path[max(until - 1, 0) :]
        axes.plot(
            out[:, 0], out[:, 1], np.full(len(out), low[2]), color="#b9c0c8", lw=0.9, alpha=0.5, zorder=1, clip_on=False
        )
        axes.plot(
            back[:, 0],
            back[:, 1],
            back[:, 2],
            color=colour,
            lw=0.8,
            alpha=0.35,
            ls=(0, (1, 2)),
            zorder=3,
            clip_on=False,
        )
        axes.plot(out[:, 0], out[:, 1], out[:, 2], color=colour, lw=1.8, alpha=0.9, zorder=4, clip_on=False)
        axes.plot(*path[0][:, None], "o", ms=6, mfc="white", mec=colour, mew=1.5, zorder=5, clip_on=False)
        if np.all(np.isfinite(end)):
            axes.plot(*end[:, None], "o", ms=15, mfc=colour, mec="white", mew=1.5, zorder=8, clip_on=False)
            axes.text(
                *end, str(track.id), color="white", fontsize=10, weight="bold", ha="center", va="center", zorder=9
            )
    _draw_graph(axes, flight, final, int(final_t[0]) if len(final_t) else instant)
    _title(figure, f"{flight.name}: trajectories, and the team {words}")
    if not flight.distances_known and len(tracks) > 1:
        axes.text2D(0.02, 0.02, "each vehicle in its own frame: no manifest tells where they start",
                    transform=axes.transAxes, color=RED)  # fmt: skip
    _explain(figure, flight)


def _draw_graph(axes: Any, flight: Flight, final: FloatArray, t_ns: int) -> None:
    """The sensing graph between the vehicles that hold its roles."""
    roles, formation = flight.roles_at(t_ns), flight.formation_at(t_ns)
    if formation is None or roles is None:
        return
    holder = {role: vehicle for vehicle, role in enumerate(roles) if role is not None and vehicle < len(final)}
    for i, j in formation.edges:
        if i in holder and j in holder:
            ends = final[[holder[i], holder[j]]]
            axes.plot(ends[:, 0], ends[:, 1], ends[:, 2], color=INK, lw=2.2, alpha=0.75, zorder=6, clip_on=False)


def _explain(figure: Figure, flight: Flight) -> None:
    from matplotlib.lines import Line2D  # noqa: PLC0415

    keys = [
        Line2D([], [], marker="o", ls="", ms=7, mfc="white", mec=INK, mew=1.5, label="start"),
        Line2D([], [], marker="o", ls="", ms=12, mfc=INK, mec="white", label="vehicle, with its number"),
        Line2D([], [], color="#b9c0c8", lw=1.2, label="path seen from above"),
    ]
    if flight.formation is not None and flight.roles:
        keys.append(Line2D([], [], color=INK, lw=2.2, alpha=0.75, label="sensing graph"))
    if any(phase.name in ("form", "hold") for phase in flight.phases):
        keys.append(Line2D([], [], color=INK, lw=1, ls=(0, (1, 2)), label="way back"))
    figure.legend(handles=keys, loc="lower center", ncols=len(keys))


def _prepare_box(axes: Any, low: FloatArray, high: FloatArray) -> None:
    axes.set_box_aspect(tuple(high - low), zoom=1.22)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_zlim(low[2], high[2])
    axes.set_xlabel("east in m", labelpad=8)
    axes.set_ylabel("north in m", labelpad=8)
    axes.set_zlabel("up in m", labelpad=2)
    axes.view_init(elev=22, azim=-52)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((0.975, 0.98, 0.985, 1.0))
        axis.line.set_color(QUIET)
    axes.locator_params(nbins=6)
    axes.zaxis.set_major_locator(_few_ticks())


def _few_ticks() -> Any:
    from matplotlib.ticker import MaxNLocator  # noqa: PLC0415

    return MaxNLocator(4)


def _draw_distances(figure: Figure, flight: Flight) -> None:
    if not flight.distances_known:
        _say_missing(figure, "Distances are not known: the log has positions of fewer than two vehicles in one frame.")
        return
    axes = figure.add_subplot()
    instants = _thinned(flight.instants_ns())
    time_s = (instants - flight.start_ns) / 1e9
    distances = flight.distances_at(instants)
    neighbours = _neighbour_pairs(flight)
    if neighbours is None:
        axes.plot(time_s, distances, color=_NEIGHBOURS, lw=1.1, alpha=0.7)
        keys = [(_NEIGHBOURS, f"all {distances.shape[1]} pairs")]
    else:
        for pairs, colour in ((~neighbours, _OTHERS), (neighbours, _NEIGHBOURS)):
            axes.plot(time_s, distances[:, pairs], color=colour, lw=1.2, alpha=0.8)
        keys = [(_NEIGHBOURS, "neighbours in the sensing graph"), (_OTHERS, "other pairs")]
    axes.set_ylim(bottom=0)
    if flight.safety_radius_m is not None:
        axes.axhline(flight.safety_radius_m, color="#777777", lw=2.5, zorder=3)
        keys.append(("#777777", f"safety radius r = {flight.safety_radius_m:g} m"))
    if not np.all(np.isnan(distances)):
        highest = float(np.nanmax(distances))
        row = int(np.nanargmin(np.nanmin(np.where(np.isnan(distances), np.inf, distances), axis=1)))
        least = float(np.nanmin(distances[row]))
        axes.plot(time_s[row], least, "o", ms=8, mfc="white", mec=RED, mew=2, zorder=5)
        shift = -4 if least > 0.2 * highest else 18
        axes.annotate(f"smallest: {least:.3f} m", (time_s[row], least), xytext=(12, shift), va="top", weight="bold",
                      textcoords="offset points", color=RED, zorder=6,
                      bbox={"boxstyle": "round,pad=0.2", "fc": "white", "ec": "none", "alpha": 0.85})  # fmt: skip
    axes.set_ylabel("distance in m")
    _title(figure, f"{flight.name}: distances between all vehicles")
    _finish_time_axis(axes, flight)
    _legend(figure, keys)


def _draw_error(figure: Figure, flight: Flight) -> None:
    instants = _thinned(flight.instants_ns())
    error = flight.formation_error_at(instants)
    if np.all(np.isnan(error)):
        _say_missing(
            figure,
            "The formation error is not known: the log tells no formation, roles or common frame.\n"
            "For an imported flight: gs import ... --formation FILE",
        )
        return
    from matplotlib.ticker import LogLocator, NullFormatter  # noqa: PLC0415

    axes = figure.add_subplot()
    time_s = (instants - flight.start_ns) / 1e9
    wanted = instants <= shown_instant(flight)[0]
    axes.semilogy(time_s, np.where(wanted, np.nan, error), color=_NEIGHBOURS, lw=1.2, alpha=0.35)
    axes.semilogy(time_s, np.where(wanted, error, np.nan), color=_NEIGHBOURS, lw=2)
    keys = [(_NEIGHBOURS, "largest deviation of any distance")]
    tolerance = _tolerance_m(flight)
    if tolerance is not None:
        axes.axhline(tolerance, color="#777777", lw=2.5, zorder=1)
        keys.append(("#777777", f"tolerance {tolerance:g} m"))
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.set_ylabel("formation error in m")
    _title(figure, f"{flight.name}: formation error, largest $|d_{{ij}} - d^*_{{ij}}|$")
    _finish_time_axis(axes, flight)
    _legend(figure, keys)


def _draw_setpoints(figure: Figure, flight: Flight) -> None:
    if not flight.setpoints:
        _say_missing(figure, "The log holds no velocity setpoints (SET_POSITION_TARGET_LOCAL_NED).")
        return
    colours = _colours(len(flight.vehicles))
    rows = figure.subplots(3, 1, sharex=True, sharey=True)
    for axis, (axes, direction) in enumerate(zip(rows, ("east", "north", "up"), strict=True)):
        for track, colour in zip(flight.vehicles, colours, strict=True):
            keep = _thinning(len(track.setpoint_t_ns))
            time_s = (track.setpoint_t_ns[keep] - flight.start_ns) / 1e9
            axes.plot(time_s, track.setpoint_vel_enu_m_s[keep, axis], color=colour, lw=1.1, alpha=0.85)
        axes.axhline(0, color=QUIET, lw=0.8, zorder=1)
        axes.set_ylabel(f"{direction} in m/s")
        _finish_time_axis(axes, flight, label=axis == 2, names=axis == 0)
    _title(figure, f"{flight.name}: velocity setpoints")
    _legend(figure, [(colour, str(track.id)) for track, colour in zip(flight.vehicles, colours, strict=True)][:12],
            title="vehicle" if len(flight.vehicles) <= 12 else f"vehicle (12 of {len(flight.vehicles)})")  # fmt: skip


PICTURES = (
    Picture(
        "trajectories",
        "Trajectories",
        "Reported positions in the team's frame, and the sensing graph between the vehicles that hold its roles.",
        (12.0, 8.0),
        _draw_trajectories,
    ),
    Picture(
        "distances",
        "Distances",
        "Distances between all pairs of vehicles, from reported positions brought to the same instants.",
        (12.0, 6.4),
        _draw_distances,
    ),
    Picture(
        "formation_error",
        "Formation error",
        "The largest deviation of any distance from the formation's, under the roles of that time.",
        (12.0, 5.4),
        _draw_error,
    ),
    Picture(
        "setpoints",
        "Velocity setpoints",
        "What the ground station asked each vehicle for, by direction.",
        (12.0, 8.4),
        _draw_setpoints,
    ),
)


def _finish_time_axis(axes: Axes, flight: Flight, *, label: bool = True, names: bool = True) -> None:
    stop_s = max(flight.duration_s, 1e-3)
    axes.set_xlim(0.0, stop_s)
    if label:
        axes.set_xlabel("time in s")
    for number, phase in enumerate(_spans(flight)):
        start, stop = ((t - flight.start_ns) / 1e9 for t in (phase.start_ns, phase.stop_ns))
        if number % 2 == 0:
            axes.axvspan(start, stop, color="#f1f4f7", zorder=0, lw=0)
        axes.axvline(start, color=LINE, lw=1, zorder=0)
        if names and stop - start > 0.0068 * stop_s * len(phase.name):
            axes.annotate(phase.name, ((start + stop) / 2, 1), xycoords=("data", "axes fraction"), xytext=(0, 6),
                          textcoords="offset points", ha="center", va="bottom", color=INK, fontsize=12)  # fmt: skip


def _spans(flight: Flight) -> list[Phase]:
    return [phase for phase in flight.phases if phase.stop_ns > phase.start_ns]


def _title(figure: Figure, text: str) -> None:
    figure.suptitle(text, x=0.012, ha="left", weight="bold", fontsize=16, color=INK)


def _legend(figure: Figure, keys: Sequence[tuple[str, str]], title: str | None = None) -> None:
    from matplotlib.lines import Line2D  # noqa: PLC0415

    lines = [Line2D([], [], color=colour, lw=3, label=text) for colour, text in keys]
    if title is not None:
        lines.insert(0, Line2D([], [], ls="", label=title))
    figure.legend(handles=lines, loc="outside lower center", ncols=len(lines), handlelength=1.4, columnspacing=1.6)


def _say_missing(figure: Figure, text: str) -> None:
    figure.clear()
    figure.text(0.5, 0.5, text, ha="center", va="center", color=QUIET, fontsize=16)


def _colours(count: int) -> list[Any]:
    if count <= len(SERIES):
        return list(SERIES[:count])
    import matplotlib as mpl  # noqa: PLC0415

    return list(mpl.colormaps["viridis"](np.linspace(0.0, 0.9, count)))


def _box(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Corners of a box around all points, none of its sides shorter than a quarter of the longest."""
    low, high = points.min(axis=0), points.max(axis=0)
    extent = np.maximum(high - low, 0.25 * max(float((high - low).max()), 0.4)) * 1.08
    middle = (low + high) / 2
    return middle - extent / 2, middle + extent / 2


def _thinning(count: int) -> IntArray:
    return np.unique(np.linspace(0, count - 1, min(count, _MOST_INSTANTS)).astype(np.int64))


def _thinned(instants: IntArray) -> IntArray:
    return instants[_thinning(len(instants))] if len(instants) else instants


def _latest_known(flight: Flight, instant: int) -> IntArray:
    """The latest report of any vehicle, up to an instant, at which most vehicles' positions are known; shape (1,)."""
    instants = flight.instants_ns()
    before = instants[instants <= instant][-50:]
    if not len(before):
        return instants[:1]
    known = np.all(np.isfinite(flight.positions_at(before)), axis=-1).sum(axis=-1)
    return before[[np.flatnonzero(known == known.max())[-1]]]


def _neighbour_pairs(flight: Flight) -> BoolArray | None:
    """Whether each pair (columns as ``Flight.distances_at``) ends as neighbours; None when that is not known."""
    instant = shown_instant(flight)[0]
    roles, formation = flight.roles_at(instant), flight.formation_at(instant)
    if formation is None or roles is None or len(roles) != len(flight.vehicles):
        return None
    edges = set(formation.edges) | {(j, i) for i, j in formation.edges}
    first, second = np.triu_indices(len(roles), 1)
    return np.array([(roles[i], roles[j]) in edges for i, j in zip(first, second, strict=True)], dtype=np.bool_)


def _tolerance_m(flight: Flight) -> float | None:
    steps = [] if flight.manifest is None else flight.manifest.mission.get("steps") or []
    forms = [step["form"] for step in steps if isinstance(step, dict) and isinstance(step.get("form"), dict)]
    value = forms[-1].get("tolerance_m") if forms else None
    return float(value) if isinstance(value, int | float) else None


def _metres(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.4f} m"
