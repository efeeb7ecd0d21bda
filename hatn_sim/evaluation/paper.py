"""Every number of the paper's tables (Wang et al., arXiv 2202.05140), as printed there.

Errors are metres. What the paper prints in per cent are shares here. What stands
behind a mean is the standard deviation over samples. The paper's data are recordings of human
traffic at one five-arm intersection, trained on, and one eight-arm roundabout, not trained on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

SCENARIOS: Final = ("intersection", "roundabout")
PERCENT: Final = frozenset({"slot_accuracy", "ade_2_change"})
"""Measures that the paper prints in per cent."""


@dataclass(frozen=True)
class Cell:
    """A number of the paper."""

    mean: float
    std: float | None
    printed: str  # as in the paper


@dataclass(frozen=True, eq=False)
class PaperTable:
    """One table of the paper, or one part of it."""

    key: str
    title: str
    source: str  # where in the paper
    measures: tuple[str, ...]  # as scores call them
    rows: Mapping[str, Mapping[tuple[str, str], Cell]]  # name -> (scenario, measure) -> number


def _table(
    key: str, title: str, source: str, measures: tuple[str, ...], rows: Mapping[str, str]
) -> PaperTable:
    """Rows are the numbers of the intersection and then of the roundabout, by measure."""
    places = [(scenario, measure) for scenario in SCENARIOS for measure in measures]
    cells = {
        name: {
            place: _cell(text, 0.01 if place[1] in PERCENT else 1.0)
            for place, text in zip(places, row.split("|"), strict=True)
        }
        for name, row in rows.items()
    }
    return PaperTable(key, title, source, measures, cells)


def _cell(text: str, factor: float) -> Cell:
    mean, _, std = text.strip().partition("±")
    return Cell(factor * float(mean), factor * float(std) if std else None, text.strip())


SGN: Final = _table(
    "sgn",
    "Semantic graph network: features and architectures",
    "table 2, section 'Semantic graph network evaluation'",
    ("slot_accuracy", "goal_error"),
    {
        "No-Temporal": "87.44 ± 33.13 | 1.59 ± 1.67 | 93.92 ± 23.88 | 3.62 ± 6.72",
        "GAT": "91.93 ± 27.05 | 1.18 ± 1.51 | 91.21 ± 28.12 | 2.70 ± 5.16",
        "Single-Agent": "88.8 ± 31.53 | 1.04 ± 0.90 | 92.20 ± 26.75 | 1.88 ± 2.48",
        "Two-Layer-Graph": "90.15 ± 29.79 | 0.98 ± 0.93 | 90.54 ± 29.26 | 1.87 ± 2.51",
        "Multi-Head": "90.00 ± 30.00 | 0.97 ± 0.75 | 92.10 ± 26.96 | 2.79 ± 20.78",
        "Seq-Graph": "89.8 ± 30.24 | 1.33 ± 1.91 | 91.60 ± 27.62 | 3.10 ± 3.10",
        "Ours": "90.50 ± 28.70 | 0.94 ± 0.73 | 90.70 ± 29.08 | 1.70 ± 1.99",
    },
)

_EDN_SOURCE: Final = "table 3, section 'Encoder decoder network evaluation'"
_ADE_FDE: Final = ("ade_3s", "fde_3s")
EDN: Final = (
    _table(
        "edn.a",
        "Encoder decoder network (a): coordinates",
        _EDN_SOURCE,
        _ADE_FDE,
        {
            "Cartesian": "1.53 ± 1.22 | 2.90 ± 2.77 | 12.57 ± 5.68 | 19.77 ± 7.43",
            "Frenet": "0.91 ± 0.59 | 1.87 ± 1.48 | 2.96 ± 4.65 | 5.52 ± 7.20",
        },
    ),
    _table(
        "edn.b",
        "Encoder decoder network (b): speed, on Frenet coordinates",
        _EDN_SOURCE,
        _ADE_FDE,
        {
            "no speed": "0.91 ± 0.59 | 1.87 ± 1.48 | 2.96 ± 4.65 | 5.52 ± 7.20",
            "speed in": "0.71 ± 0.54 | 1.53 ± 1.27 | 2.33 ± 3.84 | 4.30 ± 5.44",
            "speed out": "0.78 ± 0.53 | 1.74 ± 1.41 | 2.51 ± 4.16 | 4.97 ± 6.35",
            "speed in, out": "0.70 ± 0.49 | 1.46 ± 1.26 | 2.40 ± 4.10 | 4.67 ± 6.03",
        },
    ),
    _table(
        "edn.c",
        "Encoder decoder network (c): yaw, with speed in",
        _EDN_SOURCE,
        _ADE_FDE,
        {
            "no yaw": "0.71 ± 0.54 | 1.53 ± 1.27 | 2.33 ± 3.84 | 4.30 ± 5.44",
            "yaw in": "0.67 ± 0.46 | 1.45 ± 1.19 | 2.23 ± 3.95 | 4.14 ± 5.19",
            "yaw out": "0.73 ± 0.50 | 1.59 ± 1.36 | 2.34 ± 3.96 | 4.49 ± 6.46",
            "yaw in, out": "0.67 ± 0.48 | 1.46 ± 1.24 | 2.51 ± 4.60 | 4.77 ± 6.43",
        },
    ),
    _table(
        "edn.d",
        "Encoder decoder network (d): representation, with speed and yaw in",
        _EDN_SOURCE,
        _ADE_FDE,
        {
            "neither": "0.67 ± 0.46 | 1.45 ± 1.19 | 2.23 ± 3.95 | 4.14 ± 5.19",
            "aligned": "0.48 ± 0.44 | 1.32 ± 1.32 | 1.26 ± 0.95 | 3.04 ± 2.44",
            "incremental": "0.43 ± 0.35 | 1.36 ± 1.19 | 1.07 ± 1.10 | 2.66 ± 2.31",
            "incremental, aligned": "0.41 ± 0.33 | 1.29 ± 1.14 | 0.96 ± 0.80 | 2.53 ± 2.13",
        },
    ),
    _table(
        "edn.e",
        "Encoder decoder network (e): mechanisms, incremental and aligned",
        _EDN_SOURCE,
        _ADE_FDE,
        {
            "neither": "0.41 ± 0.33 | 1.29 ± 1.14 | 0.96 ± 0.80 | 2.53 ± 2.13",
            "teacher forcing": "0.41 ± 0.34 | 1.32 ± 1.16 | 0.97 ± 0.83 | 2.54 ± 2.14",
            "attention": "0.43 ± 0.34 | 1.32 ± 1.13 | 1.10 ± 1.32 | 2.57 ± 2.50",
        },
    ),
)

_INTENTION_SOURCE: Final = "table 4, section 'Intention signal integration evaluation'"
_NO_INTENTION: Final = "0.41 ± 0.11 | 1.29 ± 1.30 | 0.96 ± 0.64 | 2.53 ± 4.54"
INTENTION: Final = (
    _table(
        "intention.a",
        "Intention signal (a): the true goal",
        _INTENTION_SOURCE,
        _ADE_FDE,
        {
            "No-Intention": _NO_INTENTION,
            "Transform": "0.10 ± 0.10 | 0.15 ± 0.25 | 0.42 ± 0.37 | 0.72 ± 0.66",
            "Input": "0.15 ± 0.13 | 0.29 ± 0.40 | 0.51 ± 0.46 | 0.94 ± 0.73",
            "Output": "0.17 ± 0.16 | 0.38 ± 0.41 | 0.60 ± 0.54 | 1.03 ± 0.74",
            "Hidden": "0.13 ± 0.14 | 0.26 ± 0.39 | 0.48 ± 0.41 | 0.84 ± 0.67",
        },
    ),
    _table(
        "intention.b",
        "Intention signal (b): the predicted goal",
        _INTENTION_SOURCE,
        _ADE_FDE,
        {
            "No-Intention": _NO_INTENTION,
            "Transform": "0.31 ± 0.25 | 0.92 ± 0.85 | 0.89 ± 0.56 | 2.14 ± 1.44",
            "Input": "0.30 ± 0.25 | 0.89 ± 0.83 | 0.86 ± 0.61 | 2.12 ± 1.51",
            "Output": "0.32 ± 0.25 | 0.89 ± 0.83 | 0.92 ± 0.75 | 2.19 ± 1.69",
            "Hidden": "0.31 ± 0.25 | 0.89 ± 0.82 | 0.87 ± 0.54 | 2.22 ± 1.46",
        },
    ),
    _table(
        "intention.c",
        "Intention signal (c): the time signal, with the predicted goal as input",
        _INTENTION_SOURCE,
        _ADE_FDE,
        {
            "No-Intention": _NO_INTENTION,
            "Transform": "0.30 ± 0.25 | 0.89 ± 0.83 | 0.86 ± 0.61 | 2.12 ± 1.51",
            "Input": "0.30 ± 0.25 | 0.88 ± 0.83 | 0.82 ± 0.53 | 2.06 ± 1.43",
            "Output": "0.30 ± 0.25 | 0.89 ± 0.83 | 0.87 ± 0.59 | 2.15 ± 1.51",
            "Hidden": "0.30 ± 0.24 | 0.88 ± 0.81 | 0.84 ± 0.53 | 2.11 ± 0.23",
        },
    ),
)

ADAPTATION: Final = _table(
    "adaptation",
    "Online adaptation: change of the error in the next 0.1 tau s (ADE 2)",
    "section 'Trade-off in adaptation step', in the text: best at tau = 3, last layer",
    ("ade_2_change",),
    {"tau = 3": "-20.5 | -28.7"},
)

_BOTH_HORIZONS: Final = ("ade_3s", "ade_0s3", "fde_3s", "fde_0s3")
SUMMARY: Final = _table(
    "summary",
    "Summary of the ablations",
    "table 5, section 'A summary of ablation study results'",
    _BOTH_HORIZONS,
    {
        "Baseline": "0.884 ± 0.594 | 0.409 ± 0.245 | 1.850 ± 1.684 | 0.423 ± 0.245 |"
        "2.924 ± 4.695 | 1.572 ± 4.029 | 5.446 ± 7.157 | 1.546 ± 3.894",
        "Feature": "0.629 ± 0.397 | 0.319 ± 0.224 | 1.416 ± 1.175 | 0.324 ± 0.229 |"
        "2.201 ± 3.999 | 1.543 ± 3.957 | 4.123 ± 5.227 | 1.544 ± 3.944",
        "Representation": "0.407 ± 0.328 | 0.027 ± 0.020 | 1.279 ± 1.130 | 0.040 ± 0.034 |"
        "0.941 ± 0.778 | 0.062 ± 0.071 | 2.494 ± 2.070 | 0.088 ± 0.104",
        "Goal State Signal": "0.302 ± 0.251 | 0.021 ± 0.017 | 0.890 ± 0.831 | 0.036 ± 0.025 |"
        "0.845 ± 0.564 | 0.060 ± 0.060 | 2.081 ± 1.440 | 0.091 ± 0.101",
        "Time Signal": "0.305 ± 0.253 | 0.029 ± 0.020 | 0.876 ± 0.835 | 0.043 ± 0.032 |"
        "0.815 ± 0.526 | 0.073 ± 0.065 | 2.038 ± 1.409 | 0.108 ± 0.107",
        "Ours": "0.301 ± 0.250 | 0.023 ± 0.014 | 0.877 ± 0.830 | 0.032 ± 0.024 |"
        "0.815 ± 0.526 | 0.052 ± 0.068 | 2.041 ± 1.409 | 0.079 ± 0.114",
    },
)
SUMMARISES: Final[Mapping[str, tuple[str, str]]] = {
    "Baseline": ("edn.a", "Frenet"),
    "Feature": ("edn.c", "yaw in"),
    "Representation": ("edn.d", "incremental, aligned"),
    "Goal State Signal": ("intention.b", "Input"),
    "Time Signal": ("intention.c", "Input"),
    "Ours": ("intention.b", "hatn"),
}
"""Row of the summary -> the table and row of the ablation that it is. The last is the paper's whole
method, which is the row before it that adapts online; beside it stands ours, which does not."""

SOTA: Final = _table(
    "sota",
    "Comparison with other methods",
    "table 6, section 'Comparison with other methods'",
    _BOTH_HORIZONS,
    {
        "IDM": "2.847 ± 1.963 | 0.042 ± 0.014 | 7.655 ± 5.536 | 0.091 ± 0.033 |"
        "5.271 ± 1.950 | 0.126 ± 0.062 | 13.891 ± 5.845 | 0.206 ± 0.096",
        "FSM-D": "3.181 ± 2.403 | 0.051 ± 0.034 | 8.709 ± 7.081 | 0.103 ± 0.059 |"
        "4.637 ± 1.448 | 0.093 ± 0.070 | 13.133 ± 4.208 | 0.157 ± 0.105",
        "FSM-T": "3.372 ± 2.495 | 0.054 ± 0.034 | 9.011 ± 7.192 | 0.111 ± 0.059 |"
        "4.824 ± 1.509 | 0.101 ± 0.004 | 13.505 ± 4.407 | 0.162 ± 0.102",
        "V-LSTM": "1.315 ± 1.177 | 0.073 ± 0.006 | 3.386 ± 2.229 | 0.140 ± 0.003 |"
        "2.202 ± 4.295 | 0.061 ± 0.001 | 6.136 ± 8.445 | 0.189 ± 0.008",
        "S-LSTM": "1.277 ± 1.295 | 0.047 ± 0.003 | 3.160 ± 2.387 | 0.112 ± 0.001 |"
        "2.459 ± 4.675 | 0.099 ± 0.002 | 6.668 ± 9.081 | 0.162 ± 0.003",
        "S-GAN": "1.372 ± 1.221 | 0.073 ± 0.004 | 3.469 ± 2.265 | 0.153 ± 0.002 |"
        "2.273 ± 4.448 | 0.090 ± 0.003 | 6.354 ± 9.499 | 0.211 ± 0.006",
        "GRIP++": "0.949 ± 0.670 | 0.024 ± 0.002 | 2.646 ± 5.773 | 0.037 ± 0.007 |"
        "1.543 ± 1.021 | 0.034 ± 0.004 | 4.352 ± 8.420 | 0.055 ± 0.001",
        "Trajectron++": "0.510 ± 0.440 | 0.009 ± 0.008 | 1.617 ± 1.517 | 0.014 ± 0.013 |"
        "1.250 ± 0.849 | 0.015 ± 0.011 | 4.063 ± 2.706 | 0.025 ± 0.020",
        "HATN": "0.301 ± 0.250 | 0.023 ± 0.014 | 0.877 ± 0.830 | 0.032 ± 0.024 |"
        "0.815 ± 0.526 | 0.052 ± 0.068 | 2.041 ± 1.409 | 0.079 ± 0.114",
    },
)
SOTA_PREDICTORS: Final[Mapping[str, str]] = {
    "IDM": "idm",
    "FSM-D": "fsm_d",
    "FSM-T": "fsm_t",
    "HATN": "hatn-paper",
}
"""Row of the comparison -> our predictor of the same kind."""

TABLES: Final[Mapping[str, tuple[PaperTable, ...]]] = {
    "sgn": (SGN,),
    "edn": EDN,
    "intention": INTENTION,
    "adaptation": (ADAPTATION,),
    "summary": (SUMMARY,),
    "sota": (SOTA,),
}
"""Name of a table -> its parts."""

RUNTIME_MS: Final[Mapping[str, float]] = {
    "sgn": 1.0,
    "edn": 18.0,
    "adaptation_1": 30.0,
    "adaptation_3": 100.0,
}
"""Appendix 'Running time': of one forward pass, for 1 to 100 agents, on an NVIDIA RTX 2060; of the
adaptation for each sample, with tau = 1 and 3."""


def scenario_of(scene: str) -> str | None:
    """Which of the paper's scenarios a scene is like, by its name; None: like neither."""
    return next((scenario for scenario in SCENARIOS if scenario in scene.lower()), None)
