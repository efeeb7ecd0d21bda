"""What an adviser is asked for, and what of it is given."""

from __future__ import annotations

from dataclasses import replace

from test_alert import moment

from hatn_sim.loop import Adviser, advise, begin
from hatn_sim.predictors.find import load_predictor


def test_suggestions_are_the_same_without_alerts() -> None:
    now = moment((20.0, 9.0, 0.0), (20.0, 9.0, 0.0))
    adviser = Adviser(load_predictor("constant_velocity"))
    state = begin(adviser, now.road)
    state = replace(state, perception=replace(state.perception, seen=now.seen))
    with_alerts, both = advise(adviser, state, now.scene, now.prediction)
    without, suggestions_only = advise(
        replace(adviser, alerts=False), state, now.scene, now.prediction
    )
    assert both.suggestions and both.alerts
    assert suggestions_only.suggestions == both.suggestions and suggestions_only.alerts == ()
    assert without.suggestions == with_alerts.suggestions
    assert without.alerts is state.alerts and without.recent is state.recent  # nothing is kept
