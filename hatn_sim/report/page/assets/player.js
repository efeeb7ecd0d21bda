// Plays the run: time, the link to a moment, what is shown at it.

const SPEEDS = [0.25, 0.5, 1, 2, 4, 8];

function byId(id) { return document.getElementById(id); }

function makeApp(head) {
  const app = {
    head, store: chunkStore(head), paths: roadPaths(head.road), shapes: vehicleShapes(head.vehicles),
    lines: [], frame: 0, ego: -1, pointed: -1, playing: false, speed: 1, following: false,
    startS: head.start_s, endS: head.start_s + Math.max(head.frames - 1, 0) * head.dt_s,
    still: window.matchMedia('(prefers-reduced-motion: reduce)').matches,
    look: LOOKS.light, egoAdvice: [], moments: [],
  };
  app.timeOf = (frame) => head.start_s + frame * head.dt_s;
  app.frameOf = (seconds) => Math.min(Math.max((seconds - head.start_s) / head.dt_s, 0), Math.max(head.frames - 1, 0));
  app.ground = groundOf(app.paths);
  app.moments = momentsOf(app);
  return app;
}

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
  return {
    frame, time, states, logged, ego, slots, involved, alerts,
    closed: chunk.closed[frame % head.chunk_frames] || [], advice: standingAdvice(app, frame),
  };
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
  drawSignals(ctx, app.paths, view.closed, look);
  if (camera.scale >= 1.2) {
    drawSlots(ctx, app, view);
    drawForecasts(ctx, app, view);
  }
  const lit = app.still || (view.time * 1.25) % 1 < 0.5;
  for (const state of view.states.values()) {
    if (!camera.sees(state.x, state.y, 15)) continue;
    const isEgo = state.vehicle === app.ego, chance = view.involved.get(state.vehicle);
    const ring = chance === undefined || chance === null ? null : chanceColour(chance);
    const faded = app.ego >= 0 && view.ego !== null && !view.involved.has(state.vehicle);
    drawVehicle(ctx, camera, state, app.shapes(state.vehicle), app.head.vehicles[state.vehicle],
      { ring, isEgo, faded, lit, look });
  }
  if (camera.scale >= 1.2) drawConflicts(ctx, view, look);
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

// An alert about the ego goes before its advice.
function showSaid(app, view) {
  const alert = view.alerts.find(({ ego, other }) => ego === app.ego || other === app.ego);
  const words = alert ? alert.text : view.advice ? view.advice.text : '';
  const place = byId('said');
  if (place.textContent !== words) place.textContent = words;
  place.classList.toggle('alarmed', alert !== undefined);
}

async function start() {
  const head = await unpackedJson(byId('head').textContent);
  const app = makeApp(head);
  const canvas = byId('map'), ctx = canvas.getContext('2d');
  app.camera = mapCamera(canvas);
  let dirty = true, panelAt = 0, linkAt = 0, before = 0;
  const redraw = () => { dirty = true; };

  app.choose = (vehicle) => {
    app.ego = vehicle;
    app.egoAdvice = adviceOf(app, vehicle);
    byId('ego').value = String(vehicle);
    panelAt = 0;
    redraw();
  };
  const seek = (frame) => {
    app.frame = Math.min(Math.max(frame, 0), Math.max(head.frames - 1, 0));
    panelAt = 0;
    redraw();
  };
  const jump = (seconds, vehicle) => {
    pause();
    seek(Math.round(app.frameOf(seconds)));
    if (vehicle !== null && vehicle >= 0) {
      app.choose(vehicle);
      centreOn(vehicle);
    }
  };
  const centreOn = async (vehicle) => {
    await app.store.ask(Math.floor(app.frame / head.chunk_frames));
    const state = stateAt(app.store, head, Math.floor(app.frame), vehicle);
    if (state) app.camera.lookAt(state.x, state.y, Math.max(app.camera.scale, 7));
    redraw();
  };
  const play = () => {
    if (app.frame >= head.frames - 1) app.frame = 0;
    app.playing = true;
    showPlaying();
  };
  const pause = () => {
    app.playing = false;
    app.frame = Math.round(app.frame);
    showPlaying();
  };
  const showPlaying = () => {
    byId('play').textContent = app.playing ? '\u23f8' : '\u25b6';
    byId('play').setAttribute('aria-label', app.playing ? 'Pause' : 'Play');
    panelAt = 0;
    redraw();
  };
  const step = (frames) => { pause(); seek(app.frame + frames); };
  const setSpeed = (speed) => { app.speed = speed; byId('speed').value = String(speed); };
  const follow = (on) => {
    app.following = on;
    byId('follow').setAttribute('aria-pressed', String(on));
    redraw();
  };
  const showAll = () => {
    follow(false);
    app.camera.fit(app.paths.bounds || boundsOf(app));
    redraw();
  };
  const setTheme = (dark) => {
    app.look = dark ? LOOKS.dark : LOOKS.light;
    document.documentElement.dataset.theme = dark ? 'dark' : 'light';
    redraw();
  };
  const toggleTheme = () => setTheme(document.documentElement.dataset.theme !== 'dark');
  const jumpToMoment = (direction) => {
    const now = app.timeOf(app.frame);
    const found = direction > 0 ? app.moments.find((moment) => moment.from > now + 0.05)
      : app.moments.findLast((moment) => moment.from < now - 0.05);
    if (found) jump(found.from, found.ego);
  };
  const nextEgo = (direction) => {
    const view = viewOf(app);
    const here = view ? [...view.states.keys()].sort((a, b) => a - b) : [];
    if (!here.length) return;
    const at = here.indexOf(app.ego);
    app.choose(here[(at + direction + here.length) % here.length]);
  };

  const timeline = timelineOf(app, jump);
  const link = () => {
    const ego = app.ego >= 0 ? `&ego=${encodeURIComponent(head.vehicles[app.ego].id)}` : '';
    return `#t=${app.timeOf(app.frame).toFixed(1)}${ego}`;
  };
  const readLink = () => {
    const asked = new URLSearchParams(location.hash.slice(1));
    const seconds = Number.parseFloat(asked.get('t') ?? '');
    const vehicle = head.vehicles.findIndex(({ id }) => id === asked.get('ego'));
    if (vehicle >= 0) app.choose(vehicle);
    if (Number.isFinite(seconds)) seek(Math.round(app.frameOf(seconds)));
    return { seconds: Number.isFinite(seconds), vehicle: vehicle >= 0 };
  };

  const drawAll = (now) => {
    requestAnimationFrame(drawAll);
    if (app.playing) {
      app.frame += Math.min((now - before) / 1000, 0.25) * app.speed / head.dt_s;
      if (app.frame >= head.frames - 1) { app.frame = head.frames - 1; pause(); }
      dirty = true;
    }
    before = now;
    const number = Math.floor(app.frame / head.chunk_frames);
    for (const wanted of [number, number + 1]) {
      if (!app.store.has(wanted)) app.store.ask(wanted).then(redraw);
    }
    if (!dirty) return;
    const view = head.frames ? viewOf(app) : emptyView(app);
    if (!view) return;
    dirty = false;
    if (app.following && view.ego) app.camera.lookAt(view.ego.x, view.ego.y);
    drawScene(ctx, app, view);
    byId('clock').textContent = `${view.time.toFixed(1)} s`;
    byId('scrub').value = String(view.time);
    byId('scrub').setAttribute('aria-valuetext', `${view.time.toFixed(1)} seconds`);
    timeline.draw(view.time);
    if (now - panelAt > 150 || panelAt === 0) {
      panelAt = now;
      drawPanel(app, view);
      showSaid(app, view);
    } else dirty = true;
    // Browsers slow down pages that change their address often.
    if (now - linkAt > 400 && !app.playing && link() !== location.hash) {
      linkAt = now;
      history.replaceState(null, '', link());
    } else if (!app.playing && link() !== location.hash) dirty = true;
    app.drawn = (app.drawn || 0) + 1;
  };

  fillIn(app);
  makeMoments(app, jump);
  makeScores(app);
  makeSettings(app);
  makeLegend();
  bindPointer(canvas, app, redraw, () => follow(false));
  const actions = {
    back: () => step(-1), forth: () => step(1), play: () => (app.playing ? pause() : play()),
    closer: () => { app.camera.zoom(1.3); redraw(); }, farther: () => { app.camera.zoom(1 / 1.3); redraw(); },
    whole: showAll, follow: () => follow(!app.following), theme: toggleTheme,
    link: () => copied(location.href.split('#')[0] + link(), byId('link')),
    keys: () => {
      byId('help').hidden = !byId('help').hidden;
      byId('keys').setAttribute('aria-expanded', String(!byId('help').hidden));
    },
  };
  for (const [id, action] of Object.entries(actions)) byId(id).addEventListener('click', action);
  byId('scrub').addEventListener('input', (event) => { pause(); seek(Math.round(app.frameOf(Number(event.target.value)))); });
  byId('speed').addEventListener('change', (event) => setSpeed(Number(event.target.value)));
  byId('ego').addEventListener('change', (event) => { app.choose(Number(event.target.value)); centreOn(app.ego); });
  bindKeys({ ...actions, step, seek, jumpToMoment, nextEgo, setSpeed, app });
  window.addEventListener('hashchange', () => { readLink(); redraw(); });
  const darkly = window.matchMedia('(prefers-color-scheme: dark)');
  setTheme(darkly.matches);
  darkly.addEventListener('change', (event) => setTheme(event.matches));
  new ResizeObserver(() => { app.camera.resize(); redraw(); }).observe(canvas);
  app.camera.resize();
  app.camera.fit(app.paths.bounds || boundsOf(app));
  const asked = readLink();
  if (!asked.seconds) seek(head.opens_at);
  if (!asked.vehicle) app.choose(head.opens_with);
  setSpeed(1);
  await app.store.ask(Math.floor(app.frame / head.chunk_frames));
  if (app.ego >= 0) centreOn(app.ego);
  requestAnimationFrame((now) => { before = now; drawAll(now); });
  window.hatn = readOnlyHook(app);
}

function emptyView(app) {
  return {
    frame: 0, time: app.startS, states: new Map(), logged: new Map(), ego: null, slots: [],
    involved: new Map(), alerts: [], closed: [], advice: null,
  };
}

function boundsOf(app) {
  const chunk = app.store.now(0);
  if (!chunk || !chunk.x.length) return [-50, -50, 50, 50];
  const xs = [...chunk.x].map((x) => x / PER_M), ys = [...chunk.y].map((y) => y / PER_M);
  return [Math.min(...xs) - 10, Math.min(...ys) - 10, Math.max(...xs) + 10, Math.max(...ys) + 10];
}

function fillIn(app) {
  const { head } = app;
  document.title = `${head.title} \u2013 hatn-sim`;
  byId('title').textContent = head.title;
  const words = [head.predictor === null ? 'nothing predicted' : `predictor: ${head.predictor}`];
  if (head.by_route) words.push('lines from the simulator\u2019s routes');
  words.push(`${head.vehicles.length} road users`, `${(app.endS - app.startS).toFixed(1)} s`);
  byId('subtitle').textContent = words.join(' \u00b7 ');
  if (!head.finished) {
    byId('unfinished').hidden = false;
    byId('unfinished').textContent = `This run was stopped before its end: ${head.frames} frames of it are here.`;
  }
  Object.assign(byId('scrub'), { min: String(app.startS), max: String(app.endS), step: String(head.dt_s) });
  byId('speed').append(...SPEEDS.map((speed) => element('option', { value: String(speed), textContent: `${speed}\u00d7` })));
  byId('ego').append(element('option', { value: '-1', textContent: 'none' }),
    ...head.vehicles.map(({ id }, i) => element('option', { value: String(i), textContent: shortened(id, 48) })));
  byId('help').append(...KEYS.map(([key, words]) => element('span', {}, [element('kbd', { textContent: key }), ` ${words}`])));
}

// For tests and for the curious: what is drawn, in metres of the log's own frame. Changes nothing.
function readOnlyHook(app) {
  const { head, store } = app;
  const [originX, originY] = head.origin_m;
  const onMap = ([x, y]) => [x + originX, y + originY];
  return Object.freeze({
    async at(seconds) {
      const frame = Math.round(app.frameOf(seconds));
      await store.ask(Math.floor(frame / head.chunk_frames));
      const chunk = store.now(Math.floor(frame / head.chunk_frames));
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
        said: view?.advice?.text ?? null, alerts: (view?.alerts ?? []).map((alert) => ({ ...alert })),
        moments: app.moments.map((moment) => ({ ...moment })), scale: app.camera.scale,
      };
    },
    pixel(xM, yM) { return app.camera.toScreen(xM - originX, yM - originY); },
  });
}

start();
