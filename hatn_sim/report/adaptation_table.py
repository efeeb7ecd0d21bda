"""The tables of online adaptation, for a console."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, Protocol

from rich.console import Group
from rich.table import Table
from rich.text import Text

from hatn_sim.evaluation.paper import ADAPTATION, scenario_of
from hatn_sim.report.adaptation_figure import LAYERS

NONE: Final = "-"
MEKF: Final = "mekf"
LAST: Final = "dense3"
CHOSEN_STEPS: Final = 3
MEASURES: Final = {
    "ade1": "ADE 1, m",
    "ade2": "ADE 2, m",
    "ade3": "ADE 3, m",
    "ade4": "ADE 4, m",
}
SMALL_M: Final = 0.1
NOTE: Final = (
    "tau: steps of 0.1 s looked back. ADE 1, ADE 3: predicted again from then, over tau steps and "
    "over 3 s; ADE 2, ADE 4: predicted from now, over tau steps and over 3 s. Trained -> adapted, "
    "change in %"
)

LAYER_NOTE: Final = "change of ADE 2 / ADE 3 in % by the layer adapted, in the paper's names"


class Change(Protocol):
    """A measure without and with adaptation (`learn.adaptation_rows.Change`)."""

    @property
    def trained_m(self) -> float: ...

    @property
    def adapted_m(self) -> float: ...

    @property
    def low(self) -> float | None: ...

    @property
    def high(self) -> float | None: ...

    @property
    def share(self) -> float: ...


class Row(Protocol):
    """What is printed of a row of the study (`learn.adaptation_rows.AdaptationRow`)."""

    @property
    def method(self) -> str: ...

    @property
    def layer(self) -> str: ...

    @property
    def steps(self) -> int: ...

    @property
    def n(self) -> int: ...

    @property
    def changes(self) -> Mapping[str, Change]: ...


def adaptation_table(
    network: str, scene: str, steps: Sequence[Row], layers: Sequence[Row], clustered_over: str
) -> Group:
    """All of one network in one scene: `steps` and methods, and then `layers`; the paper below."""
    scenario = scenario_of(scene)
    like = f"; paper: {scenario}" if scenario is not None and scenario != scene else ""
    title = Text(f"{network} in {scene}{like}", style="bold")
    note = NOTE
    if any(change.low is not None for row in steps for change in row.changes.values()):
        note += f"; [low high] 95 % interval, paired, bootstrapped over {clustered_over}"
    return Group(
        title,
        _by_steps(steps),
        Text(f"n = {max((row.n for row in steps), default=0):,}. {note}", style="dim"),
        Text(),
        _by_layer(layers),
        Text(
            "change of ADE 2 / ADE 3 in % by the layer adapted, in the paper's names", style="dim"
        ),
        Text(),
        Text(f"ours:  {_summary(steps, layers)}"),
        Text(f"paper: {_paper(scenario)}"),
        Text(),
    )


def _by_steps(rows: Sequence[Row]) -> Table:
    table = _grid("tau", *MEASURES.values())
    for row in rows:
        name = f"{row.steps}" if row.method == MEKF else f"{row.steps} {row.method}"
        table.add_row(name, *(_cell(row.changes.get(measure)) for measure in MEASURES))
    return table


def _cell(change: Change | None) -> str:
    if change is None:
        return NONE
    decimals = 4 if change.trained_m < SMALL_M else 3
    both = " -> ".join(f"{m:.{decimals}f}" for m in (change.trained_m, change.adapted_m))
    text = f"{both}\n{_percent(change.share)}"
    if change.low is None or change.high is None:
        return text
    return f"{text} [{_percent(change.low)} {_percent(change.high)}]"


def _by_layer(rows: Sequence[Row]) -> Table:
    steps = sorted({row.steps for row in rows})
    found = {(row.layer, row.steps): row for row in rows}
    table = _grid("layer", *(f"tau {number}" for number in steps))
    for layer, name in LAYERS.items():
        cells = [
            " / ".join(_percent(row.changes[measure].share, 0) for measure in ("ade2", "ade3"))
            if (row := found.get((layer, number))) is not None and row.changes
            else NONE
            for number in steps
        ]
        table.add_row(name.translate(str.maketrans("", "", "${}")), *cells)
    return table


def _grid(first: str, *columns: str) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False)
    table.add_column(first, no_wrap=True)
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True)
    return table


def _summary(steps: Sequence[Row], layers: Sequence[Row]) -> str:
    """What the paper says of its figures, of ours."""
    by_steps = {row.steps: row.changes for row in steps if row.method == MEKF and row.changes}
    by_layer = {
        row.layer: row.changes for row in layers if row.steps == CHOSEN_STEPS and row.changes
    }
    if CHOSEN_STEPS not in by_steps:
        return "nothing was predicted"
    chosen = by_steps[CHOSEN_STEPS]
    best = min(by_steps, key=lambda number: by_steps[number]["ade2"].share)
    said = [f"ADE 2 {_percent(chosen['ade2'].share)} % at tau {CHOSEN_STEPS}"]
    said.append(f"most at tau {best}, {_percent(by_steps[best]['ade2'].share)} %")
    if by_layer:
        layer = min(by_layer, key=lambda name: by_layer[name]["ade2"].share)
        said.append(f"best layer {LAYERS[layer].translate(str.maketrans('', '', '${}'))}")
    said.append(f"ADE 4 {_percent(chosen['ade4'].share)} %")
    return "; ".join(said)


def _paper(scenario: str | None) -> str:
    cells = ADAPTATION.rows[f"tau = {CHOSEN_STEPS}"]
    told = [
        f"{100.0 * cell.mean:+.1f} %{'' if scenario else f' in its {where}'}"
        for (where, _), cell in cells.items()
        if scenario in (None, where)
    ]
    return (
        f"ADE 2 {' and '.join(told)} at tau 3; most at tau 2 to 3; best layer "
        f"{LAYERS[LAST].translate(str.maketrans('', '', '${}'))}; no gain and no harm at 3 s"
    )


def _percent(share: float, decimals: int = 1) -> str:
    return f"{100.0 * share:+.{decimals}f}"
