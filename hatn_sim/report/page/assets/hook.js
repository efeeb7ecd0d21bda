// For tests and for the curious: what is drawn, in metres of the log's own frame. Changes nothing.
function readOnlyHook(app) {
  const { head, store } = app;
  const [originX, originY] = head.origin_m;
  const onMap = ([x, y]) => [x + originX, y + originY];
  return Object.freeze({
    async at(seconds) {
      const frame = Math.round(app.frameOf(seconds));
      const number = Math.floor(frame / head.chunk_frames);
      while (!store.now(number) && document.readyState === 'loading') await new Promise((done) => setTimeout(done, 10));
      const chunk = store.now(number);
      if (!chunk) return [];
      return [...chunk.rowAt[frame % head.chunk_frames]].map(([vehicle, row]) => {
        const state = stateOf(chunk, row, vehicle);
        return {
          id: head.vehicles[vehicle].id, xy_m: onMap([state.x, state.y]), yaw_rad: state.yaw,
          speed_mps: state.speed,
          modes: modesOf(state).map(({ chance, points }) => ({ chance, xy_m: points.slice(1).map(onMap) })),
          slots: slotsOf(state).map((slot) => ({
            id: head.vehicles[slot.vehicle].id, chance: slot.chance, focus: slot.focus, length_m: slot.length,
            conflict_xy_m: slot.conflict && onMap(slot.conflict), ego_to_conflict_m: slot.egoTo,
            strip_xy_m: (slotStrip(app, stateOf(chunk, chunk.rowAt[frame % head.chunk_frames].get(slot.vehicle), slot.vehicle), slot.length) || []).map(onMap),
          })),
        };
      });
    },
    now() {
      const view = head.frames ? viewOf(app) : emptyView(app);
      return {
        time_s: app.timeOf(app.frame), ego: app.ego >= 0 ? head.vehicles[app.ego].id : null,
        playing: app.playing, speed: app.speed, following: app.following, drawn: app.drawn || 0,
        said: document.getElementById('said').textContent || null, alerts: (view?.alerts ?? []).map((alert) => ({ ...alert })),
        named: (view?.named ?? []).map((vehicle) => head.vehicles[vehicle].id),
        met_xy_m: view?.event?.met ? onMap(view.event.met) : null,
        conflicts_xy_m: view ? conflictsOf(view).map(onMap) : [],
        labels: app.labels.map(({ words, box, vehicle }) => ({ words, box, id: head.vehicles[vehicle]?.id ?? null })),
        moments: app.moments.map((moment) => ({ ...moment })), scale: app.camera.scale,
      };
    },
    // Of the ego around now: [seconds from now, m/s], as in the panel's chart.
    speeds() { return speedsAround(app, viewOf(app)); },
    pixel(xM, yM) { return app.camera.toScreen(xM - originX, yM - originY); },
  });
}
