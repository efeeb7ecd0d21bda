// What is there at a moment, and the picture of it.

const EVENT_S = 3; // an event that was jumped to is pointed at for so long

// All that is shown at a frame, which may lie between two of the log; null: it is still unpacked.
function viewOf(app) {
  const { head, store } = app;
  const frame = Math.min(Math.floor(app.frame + 1e-6), Math.max(head.frames - 1, 0));
  const part = Math.max(app.frame - frame, 0);
  const chunk = store.now(Math.floor(frame / head.chunk_frames));
  if (!chunk) return null;
  const states = new Map(), logged = new Map();
  for (const [vehicle, row] of chunk.rowAt[frame % head.chunk_frames]) {
    const state = stateOf(chunk, row, vehicle);
    logged.set(vehicle, state);
    const next = part > 1e-3 ? stateAt(store, head, frame + 1, vehicle) : null;
    states.set(vehicle, next ? between(state, next, part) : state);
  }
  const ego = states.get(app.ego) || null;
  const slots = ego ? slotsOf(logged.get(app.ego)) : [];
  const involved = new Map(slots.filter((slot) => slot.focus).map((slot) => [slot.vehicle, slot.chance]));
  if (ego) involved.set(app.ego, null);
  const time = app.timeOf(app.frame);
  const alerts = head.alerts.filter((alert) => alert.from_s <= time + 1e-6 && time < (alert.to_s ?? Infinity));
  const view = {
    frame, time, states, logged, ego, slots, involved, alerts,
    closed: chunk.closed[frame % head.chunk_frames] || [], advice: standingAdvice(app, frame),
  };
  return { ...view, named: ego ? namedOf(app, view) : [], event: ego ? eventOf(app, view) : null };
}

// The event that was jumped to, as long as it is near in time and the ego is one of its two.
function eventOf(app, view) {
  const { jumped } = app;
  if (!jumped || jumped.row !== 'events' || Math.abs(view.time - jumped.from) > EVENT_S) return null;
  if (jumped.ego !== app.ego && jumped.other !== app.ego) return null;
  const other = jumped.ego === app.ego ? jumped.other : jumped.ego;
  // Of an evasive braking the first is who braked, the second whom it was for.
  const isFor = jumped.kind === 'T2' && other === jumped.other;
  return { kind: jumped.kind, isFor, other: view.states.has(other) ? other : -1, met: jumped.met };
}

function between(state, next, part) {
  let turn = (next.yaw - state.yaw) % (2 * Math.PI);
  if (turn > Math.PI) turn -= 2 * Math.PI;
  if (turn < -Math.PI) turn += 2 * Math.PI;
  return {
    ...state,
    x: state.x + part * (next.x - state.x), y: state.y + part * (next.y - state.y),
    yaw: state.yaw + part * turn, speed: state.speed + part * (next.speed - state.speed),
  };
}

function drawScene(ctx, app, view) {
  const { camera, look } = app;
  app.ground(ctx, camera, look);
  drawSignals(ctx, camera, app.paths, view.closed, look);
  if (camera.scale >= 1.2) {
    drawSlots(ctx, app, view);
    drawForecasts(ctx, app, view);
  }
  const lit = app.still || (view.time * 1.25) % 1 < 0.5;
  for (const state of view.states.values()) {
    if (!camera.sees(state.x, state.y, 15)) continue;
    const isEgo = state.vehicle === app.ego, chance = view.involved.get(state.vehicle);
    const ring = chance === undefined || chance === null ? null : chanceColour(chance);
    const told = view.involved.has(state.vehicle) || state.vehicle === view.event?.other;
    const faded = app.ego >= 0 && view.ego !== null && !told;
    drawVehicle(ctx, camera, state, app.shapes(state.vehicle), app.head.vehicles[state.vehicle],
      { ring, isEgo, faded, lit, look });
  }
  if (camera.scale >= 1.2) drawConflicts(ctx, view, look);
  if (view.event?.met) drawMeeting(ctx, camera, view.event.met);
  drawAlarms(ctx, app, view);
  camera.inPixels(ctx);
  drawLabels(ctx, app, view);
  drawScaleBar(ctx, camera);
}

function drawScaleBar(ctx, camera) {
  const metres = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000].find((m) => m * camera.scale >= 60) || 5000;
  const width = metres * camera.scale, x = camera.width - width - 14, y = camera.height - 14;
  ctx.fillStyle = 'rgba(20,23,26,0.72)';
  ctx.beginPath();
  ctx.roundRect(x - 8, y - 20, width + 16, 28, 5);
  ctx.fill();
  ctx.fillStyle = '#ffffff';
  ctx.fillRect(x, y, width, 2);
  ctx.font = '11px system-ui, sans-serif';
  ctx.textAlign = 'center';
  ctx.textBaseline = 'alphabetic';
  ctx.fillText(`${metres} m`, x + width / 2, y - 5);
  ctx.textAlign = 'start';
}

function emptyView(app) {
  return {
    frame: 0, time: app.startS, states: new Map(), logged: new Map(), ego: null, slots: [],
    involved: new Map(), alerts: [], closed: [], advice: null, named: [], event: null,
  };
}

function boundsOf(app) {
  const chunk = app.store.now(0);
  if (!chunk || !chunk.x.length) return [-50, -50, 50, 50];
  const xs = [...chunk.x].map((x) => x / PER_M), ys = [...chunk.y].map((y) => y / PER_M);
  return [Math.min(...xs) - 10, Math.min(...ys) - 10, Math.max(...xs) + 10, Math.max(...ys) + 10];
}
