"""What is asked of a predictor, each point on real traffic."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import Any, Final

import numpy as np

from hatn_sim.conformance.mending import ALL, Fault, mended
from hatn_sim.conformance.points import BrokenError, Point, Told, check_methods, tried
from hatn_sim.conformance.scenes import (
    Footage,
    alone,
    coming_and_going,
    copy_of,
    differs_in,
    fresh,
    nobody,
    turned_round,
)
from hatn_sim.datatypes import FloatArray, Prediction, Predictor, Scene
from hatn_sim.loop import check_prediction

SUM_TOLERANCE: Final = 1e-4
SAME_M: Final = 1e-3
"""float32 products depend on the order and number of what is predicted at once."""
METHODS: Final = {
    "init": ("road",),
    "observe": ("state", "scene", "routes"),
    "predict": ("state",),
}
ORDER: Final = "everybody in the scene, in its order"
FORM: Final = "shapes, dtypes and finite numbers"
_FLOATS: Final = ("xy_m", "mode_probability", "goal_weight", "goal_mean_m", "goal_std_m")


def check_predictor(
    make: Callable[[], Predictor], footage: Footage, own: Predictor
) -> Iterator[Point]:
    """Every point in turn, of a predictor that `make` makes; `own` is HATN, to compare times."""
    predictor, told = make(), Told()
    faults: set[Fault] = set(ALL)  # that are put right, once they are told

    def run(scenes: Sequence[Scene], again: Predictor = predictor) -> list[Prediction]:
        return predict_all(again, footage, scenes, faults)[1]

    point, scenes = told.point, footage.scenes
    single = alone(scenes, footage.longest)
    yield told.first("methods", lambda: check_methods(predictor, METHODS))
    yield point("name", lambda: _check_name(predictor))
    # Tried first, while nothing that comes later has been shown in any run.
    peeking = tried("no peeking at what comes", lambda: _check_peeking(run, scenes))
    faults.clear()
    yield (order := point(ORDER, lambda: _check_everybody(predictor, footage)))
    if not order.ok:
        faults.add("order")
    yield (form := point(FORM, lambda: _each(run(scenes), _check_form)))
    if not form.ok:
        faults.add("finite")
    yield told.take(peeking)
    yield point("probabilities sum to 1", lambda: _each(run(scenes), _check_probabilities))
    yield point("goal distributions are distributions", lambda: _each(run(scenes), _check_goals))
    yield point("an empty scene", lambda: _each(run(nobody(scenes)), _check_form))
    yield point("one vehicle", lambda: _each(run(single), _check_whole))
    yield point(
        "a vehicle that goes and comes back",
        lambda: _each(run(coming_and_going(scenes, footage.longest)), _check_form),
    )
    yield point("the same again", lambda: _same(run(scenes), run(scenes), "the same predictor"))
    yield point(
        "the same of a new one", lambda: _same(run(scenes), run(scenes, make()), "a new instance")
    )
    yield point("memory is handed out", lambda: _check_memory(predictor, footage, faults))
    yield point("input is left as it is", lambda: _check_input(predictor, footage))
    yield point("the order of vehicles is without effect", lambda: _check_order(run, scenes))
    yield point(
        "routes are taken where they are given", lambda: _check_routes(predictor, footage, faults)
    )
    yield point("time", lambda: _time(predictor, own, footage))


def predict_all(
    predictor: Predictor,
    footage: Footage,
    scenes: Sequence[Scene],
    faults: Collection[Fault] = (),
) -> tuple[list[Any], list[Prediction]]:
    """The memories and predictions of every scene in turn, from nothing seen on.

    `faults` of them are put right. Raises InputError where one is wrong all the same.
    """
    state = predictor.init(fresh(footage.road))
    states: list[Any] = []
    predictions: list[Prediction] = []
    for scene in scenes:
        given = copy_of(scene)  # what is written into it is another point's affair
        state = predictor.observe(state, given, None)
        prediction = mended(predictor.predict(state), scene, faults)
        check_prediction(getattr(predictor, "name", "?"), prediction, scene)
        states.append(state)
        predictions.append(prediction)
    return states, predictions


def _check_everybody(predictor: Predictor, footage: Footage) -> None:
    state = predictor.init(fresh(footage.road))
    for scene in footage.scenes:
        state = predictor.observe(state, copy_of(scene), None)
        prediction: Any = predictor.predict(state)
        if not isinstance(prediction, Prediction):
            raise BrokenError(
                "predict to return a Prediction",
                type(prediction).__name__,
                "return hatn_sim.datatypes.Prediction",
            )
        if prediction.ids == scene.ids:
            continue
        if sorted(prediction.ids) == sorted(scene.ids):
            raise BrokenError(
                "the ids of the scene, in its order",
                "another order (put right for the points below)",
                "return ids=scene.ids and rows in that order",
            )
        found = f"{len(prediction.ids)} of {len(scene.ids)}, or others"
        raise BrokenError("the ids of the scene, all of them", found, "predict for everybody")


def _each(predictions: list[Prediction], check: Callable[[Prediction], str | None]) -> None:
    for prediction in predictions:
        check(prediction)


def _check_name(predictor: Predictor) -> str:
    name: object = getattr(predictor, "name", None)
    if not isinstance(name, str) or not name:
        raise BrokenError("a `name` that is a string", repr(name), 'add name = "mine" to the class')
    return name


def _check_form(prediction: Prediction) -> None:
    count = len(prediction.ids)
    for part in _FLOATS:
        value = getattr(prediction, part)
        if value is None:
            continue
        if value.dtype != np.float64:
            raise BrokenError(f"{part} of float64", str(value.dtype), ".astype(np.float64)")
        if len(value) != count or not np.isfinite(value).all():
            raise BrokenError(
                f"{part} of {count} vehicles, finite", f"shape {value.shape}", "mend it"
            )
    for part in ("fallback", "adapted"):
        dtype = getattr(prediction, part).dtype
        if dtype != np.bool_:
            raise BrokenError(f"{part} of bool", str(dtype), "use np.zeros(count, dtype=np.bool_)")


def _check_probabilities(prediction: Prediction) -> None:
    _check_sums("mode_probability", prediction.mode_probability)
    chances, graphs = prediction.slot_probability, prediction.graphs
    if chances is None:
        return
    if graphs is None:
        raise BrokenError("graphs with slot_probability", "none", "give both or neither")
    if chances.shape != graphs.node_mask.shape:
        raise BrokenError(
            f"slot_probability of shape {graphs.node_mask.shape}", str(chances.shape), "mend it"
        )
    _check_sums("slot_probability", chances)
    beyond = float(np.abs(np.where(graphs.focus_mask, 0.0, chances)).max(initial=0.0))
    if beyond > SUM_TOLERANCE:
        raise BrokenError("slot_probability 0 off the focus", f"{beyond:.3g}", "mask it")


def _check_whole(prediction: Prediction) -> None:
    _check_form(prediction)
    _check_probabilities(prediction)


def _check_sums(part: str, values: FloatArray) -> None:
    if not len(values):
        return
    low, sums = float(values.min()), values.sum(axis=1)
    worst = float(sums[np.abs(sums - 1.0).argmax()])
    if low < 0.0 or abs(worst - 1.0) > SUM_TOLERANCE:
        found = f"a sum of {worst:.6g}" if low >= 0.0 else f"{low:.3g}"
        raise BrokenError(
            f"{part} of each vehicle at least 0 and adding up to 1", found, "normalise it"
        )


def _check_goals(prediction: Prediction) -> str | None:
    parts = prediction.goal_weight, prediction.goal_mean_m, prediction.goal_std_m
    weight, mean, std = parts
    if weight is None or mean is None or std is None:
        if any(part is not None for part in parts):
            raise BrokenError("all of goal_weight, _mean_m, _std_m or none", "some", "give all")
        return "none given"
    if not weight.shape == mean.shape == std.shape:
        shapes = f"{weight.shape}, {mean.shape}, {std.shape}"
        raise BrokenError("goal_weight, _mean_m, _std_m of one shape", shapes, "mend it")
    _check_sums("goal_weight", weight)
    if std.size and float(std.min()) <= 0.0:
        raise BrokenError("goal_std_m above 0", f"{std.min():.3g}", "bound it from below")
    return None


def _same(one: list[Prediction], two: list[Prediction], who: str) -> None:
    for frame, (first, second) in enumerate(zip(one, two, strict=True)):
        part = _differs_in(first, second, 0.0)
        if part is not None:
            raise BrokenError(
                f"{who} to predict the same of the same scenes",
                f"another {part} at frame {frame}",
                "seed what is random in init, and keep memory in the state, not in self",
            )


def _differs_in(one: Prediction, two: Prediction, within: float) -> str | None:
    for part in ("xy_m", "mode_probability"):
        first, second = getattr(one, part), getattr(two, part)
        if first.shape != second.shape or float(np.abs(first - second).max(initial=0.0)) > within:
            return part
    return None


def _check_memory(predictor: Predictor, footage: Footage, faults: Collection[Fault]) -> None:
    states, predictions = predict_all(predictor, footage, footage.scenes, faults)
    for frame in (0, len(states) // 2):
        again = mended(predictor.predict(states[frame]), footage.scenes[frame], faults)
        if again.ids != predictions[frame].ids or _differs_in(again, predictions[frame], SAME_M):
            raise BrokenError(
                f"the memory of frame {frame} to predict, later, what it did then",
                "another prediction",
                "observe must return a new state and leave the old one as it is",
            )


def _check_peeking(
    run: Callable[[Sequence[Scene]], list[Prediction]], scenes: Sequence[Scene]
) -> None:
    half = len(scenes) // 2
    ignorant = run(scenes[:half])
    for other in (scenes, (*scenes[:half], *scenes[half:][::-1]), scenes[:half]):
        for frame, (one, two) in enumerate(zip(ignorant, run(other), strict=False)):
            part = _differs_in(one, two, SAME_M)
            if part is not None:
                raise BrokenError(
                    f"the prediction at frame {frame} to be of frames 0 to {frame}",
                    f"another {part} once what comes after frame {half - 1} was shown",
                    "use nothing but the scenes observed in this run",
                )


def _check_input(predictor: Predictor, footage: Footage) -> None:
    state = predictor.init(fresh(footage.road))
    for scene in footage.scenes:
        given = copy_of(scene)
        state = predictor.observe(state, given, None)
        predictor.predict(state)
        part = differs_in(scene, given)
        if part is not None:
            raise BrokenError("scenes left as they were", f"another {part}", "copy before writing")


def _check_order(
    run: Callable[[Sequence[Scene]], list[Prediction]], scenes: Sequence[Scene]
) -> None:
    for frame, (one, two) in enumerate(zip(run(scenes), run(turned_round(scenes)), strict=True)):
        off_m = float(np.abs(one.xy_m - two.xy_m[::-1]).max(initial=0.0))
        if off_m > SAME_M:
            row = int(np.abs(one.xy_m - two.xy_m[::-1]).max(axis=(1, 2, 3)).argmax())
            raise BrokenError(
                "vehicles in the opposite order to be predicted the same",
                f"{one.ids[row]!r} {off_m:.3f} m elsewhere at frame {frame}",
                "look vehicles up by id, never by row, from scene to scene",
            )


def _check_routes(predictor: Predictor, footage: Footage, faults: Collection[Fault]) -> None:
    state, frames = predictor.init(fresh(footage.road)), footage.frames[:12]
    for frame in frames:
        state = predictor.observe(state, copy_of(frame.scene), frame.truth.routes)
    _check_form(mended(predictor.predict(state), frames[-1].scene, faults))


def _time(predictor: Predictor, own: Predictor, footage: Footage) -> str:
    def median_ms(one: Predictor) -> float:
        state, taken_s = one.init(fresh(footage.road)), list[float]()
        for scene in footage.scenes:
            given, began = copy_of(scene), time.perf_counter()
            state = one.observe(state, given, None)
            one.predict(state)
            taken_s.append(time.perf_counter() - began)
        return 1e3 * float(np.median(taken_s))

    count = round(np.mean([len(scene.ids) for scene in footage.scenes]))
    mine, hatn = median_ms(predictor), median_ms(own)
    return f"{mine:.1f} ms a step of {count} vehicles, {own.name} {hatn:.1f} ms"
