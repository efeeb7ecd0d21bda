// Plays the run: time, the link to a moment, what is shown at it.

const SPEEDS = [0.25, 0.5, 1, 2, 4, 8];

function byId(id) { return document.getElementById(id); }

function makeApp(head) {
  const app = {
    head, store: chunkStore(head), paths: roadPaths(head.road), shapes: vehicleShapes(head.vehicles),
    lines: [], frame: 0, ego: -1, pointed: -1, playing: false, speed: 1, following: false,
    startS: head.start_s, endS: head.start_s + Math.max(head.frames - 1, 0) * head.dt_s,
    still: window.matchMedia('(prefers-reduced-motion: reduce)').matches,
    look: LOOKS.light, egoAdvice: [], moments: [], jumped: null, covers: [], free: [], openedAt: 1, lead: null,
    labels: [], labelPlaces: new Map(),
  };
  app.timeOf = (frame) => head.start_s + frame * head.dt_s;
  app.frameOf = (seconds) => Math.min(Math.max((seconds - head.start_s) / head.dt_s, 0), Math.max(head.frames - 1, 0));
  app.ground = groundOf(app.paths);
  app.moments = momentsOf(app);
  return app;
}

// An alert about the ego goes before its advice, the latest first: as `Moment.headline` has it.
function showSaid(app, view) {
  const own = view.alerts.findLast(({ ego }) => ego === app.ego);
  const alert = own || view.alerts.findLast(({ other }) => other === app.ego);
  const told = alert && (own ? alert.text : `${shortened(nameOf(app, alert.ego), 30)} is told: ${alert.text}`);
  const words = told ? told : view.advice ? countedDown(view.advice.text, view.time - app.timeOf(view.advice.frame)) : '';
  const place = byId('said');
  if (place.textContent !== words) place.textContent = words;
  place.classList.toggle('alarmed', alert !== undefined);
}

function start() {
  const head = unpackedJson(byId('head').textContent);
  const app = makeApp(head);
  const canvas = byId('map'), ctx = canvas.getContext('2d');
  app.camera = mapCamera(canvas);
  let dirty = true, panelAt = 0, linkAt = 0, before = 0, coming = 0, opening = false, looked = '';
  let shownFrame = -1, followed = null; // of the last picture; whom the camera followed in it
  const redraw = () => { dirty = true; };

  app.choose = (vehicle) => {
    app.ego = vehicle;
    app.egoAdvice = adviceOf(app, vehicle);
    app.lead = null;
    byId('ego').value = String(vehicle);
    panelAt = 0;
    redraw();
  };
  const seek = (frame) => {
    app.frame = Math.min(Math.max(frame, 0), Math.max(head.frames - 1, 0));
    panelAt = 0;
    redraw();
  };
  const jump = (seconds, vehicle, moment = null) => {
    pause();
    app.jumped = moment;
    seek(Math.round(app.frameOf(seconds)));
    if (vehicle !== null && vehicle >= 0) app.choose(vehicle);
    open();
  };
  // The camera is set up anew for the moment that is shown next.
  const open = () => { opening = true; redraw(); };
  const look = () => [app.camera.x, app.camera.y, app.camera.scale].join();
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
    byId('play').textContent = app.playing ? '\u25ae\u25ae' : '\u25b6';
    byId('play').setAttribute('aria-label', app.playing ? 'Pause' : 'Play');
    panelAt = 0;
    redraw();
  };
  const step = (frames) => { pause(); seek(app.frame + frames); };
  const setSpeed = (speed) => { app.speed = speed; byId('speed').value = String(speed); };
  const follow = (on) => {
    app.following = on;
    app.lead = null;
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
    if (found) jump(found.from, found.ego, found);
  };
  const nextEgo = (direction) => {
    const view = viewOf(app);
    const here = view ? [...view.states.keys()].sort((a, b) => a - b) : [];
    if (!here.length) return;
    const at = here.indexOf(app.ego);
    app.choose(here[(at + direction + here.length) % here.length]);
  };

  const timeline = timelineOf(app, jump);
  const showPanel = makePanel(app);
  const link = () => {
    const ego = app.ego >= 0 ? `&ego=${encodeURIComponent(head.vehicles[app.ego].id)}` : '';
    return `#t=${app.timeOf(app.frame).toFixed(1)}${ego}`;
  };
  const readLink = () => {
    const asked = askedBy(location.hash, app);
    if (asked.ego !== null) app.choose(asked.ego);
    if (asked.frame !== null) seek(asked.frame);
    byId('notice').hidden = !asked.amiss.length;
    byId('notice').textContent = asked.amiss.join(' ');
    return asked;
  };

  // The chunks beside this one are unpacked between two pictures, before they are needed.
  const prepare = () => {
    const here = Math.floor(app.frame / head.chunk_frames);
    const wanted = [here + 1, here - 1].find((number) => !app.store.ready(number));
    if (coming || wanted === undefined) return;
    coming = setTimeout(() => {
      coming = 0;
      if (app.store.now(wanted) || document.readyState === 'loading') redraw();
    });
  };
  const keepFree = () => {
    app.covers = coversOf(canvas);
    app.free = freeRectangles(app.camera.width, app.camera.height, app.covers);
  };
  // `passed`: seconds of playing since the last picture.
  const show = (now, passed = 0) => {
    const view = head.frames ? viewOf(app) : emptyView(app);
    if (!view) return; // this moment has not arrived yet
    dirty = false;
    if (opening) {
      showSaid(app, view); // what lies over the map
      keepFree();
      frameEgo(app, view);
      [opening, looked] = [false, look()];
      app.openedAt = app.camera.scale;
    } else if (app.playing || app.frame !== shownFrame || (app.following && app.ego !== followed)) {
      const isUntouched = look() === looked; // nobody has moved or zoomed it since
      const goesAlong = isUntouched && !app.still; // unasked motion
      if (app.following || goesAlong) attend(app, view, app.playing ? passed : Infinity, goesAlong);
      if (isUntouched) looked = look();
    }
    [shownFrame, followed] = [app.frame, app.following ? app.ego : null];
    drawScene(ctx, app, view);
    byId('clock').textContent = `${view.time.toFixed(1)} s`;
    byId('scrub').value = String(view.time);
    byId('scrub').setAttribute('aria-valuetext', `${view.time.toFixed(1)} seconds`);
    timeline.draw(view.time);
    if (now - panelAt > 150 || panelAt === 0) {
      panelAt = now;
      showPanel(view);
      showSaid(app, view);
      keepFree();
      markMoment(view);
    } else dirty = true;
    // Browsers slow down pages that change their address often.
    if (now - linkAt > 400 && !app.playing && link() !== location.hash) {
      linkAt = now;
      history.replaceState(null, '', link());
    } else if (!app.playing && link() !== location.hash) dirty = true;
    app.drawn = (app.drawn || 0) + 1;
    prepare();
  };
  const tick = (now) => {
    requestAnimationFrame(tick);
    const passed = Math.min(Math.max(now - before, 0) / 1000, 0.25);
    if (app.playing) {
      app.frame += passed * app.speed / head.dt_s;
      if (app.frame >= head.frames - 1) { app.frame = head.frames - 1; pause(); }
      dirty = true;
    }
    before = now;
    if (dirty) show(now, passed);
  };

  fillIn(app);
  const markMoment = makeMoments(app, jump);
  makeScores(app);
  makeSettings(app);
  makeLegend(app);
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
  byId('ego').addEventListener('change', (event) => { app.choose(Number(event.target.value)); open(); });
  bindKeys({ ...actions, step, seek, jumpToMoment, nextEgo, setSpeed, app });
  window.addEventListener('hashchange', () => { readLink(); open(); });
  const darkly = window.matchMedia('(prefers-color-scheme: dark)');
  setTheme(darkly.matches);
  darkly.addEventListener('change', (event) => setTheme(event.matches));
  app.camera.resize();
  app.camera.fit(app.paths.bounds || boundsOf(app));
  const asked = readLink();
  if (asked.frame === null) seek(head.opens_at);
  if (asked.ego === null) app.choose(asked.amiss.length ? -1 : head.opens_with);
  setSpeed(1);
  open();
  show(performance.now()); // before the page is said to be loaded
  performance.mark('first picture');
  // A canvas of another size is empty: it is drawn before anybody sees it.
  new ResizeObserver(() => {
    const unseen = app.camera.width < 2;
    app.camera.resize();
    if (unseen) app.camera.fit(app.paths.bounds || boundsOf(app));
    opening = opening || unseen || look() === looked; // nobody has moved it since
    show(performance.now());
  }).observe(canvas);
  requestAnimationFrame((now) => { before = now; tick(now); });
  window.hatn = readOnlyHook(app);
}

// What a link asks for: frame and ego, null where it does not say or cannot be followed; and in
// words what is amiss with it.
function askedBy(hash, app) {
  const { head } = app;
  const given = new URLSearchParams(hash.slice(1));
  const asked = { frame: null, ego: null, amiss: [] };
  const name = given.get('ego'), time = given.get('t');
  if (name !== null) {
    const found = head.vehicles.findIndex(({ id }) => id === name);
    if (found >= 0) asked.ego = found;
    else asked.amiss.push(`The link names the ego \u201c${shortened(name, 60)}\u201d, which is not in this run.`);
  }
  if (time !== null) {
    const seconds = Number(time);
    const from = app.startS.toFixed(1), to = app.endS.toFixed(1);
    if (!Number.isFinite(seconds) || !time.trim()) {
      asked.amiss.push(`The link names the time \u201c${shortened(time, 20)}\u201d: expected seconds from ${from} to ${to}.`);
    } else {
      asked.frame = Math.round(app.frameOf(seconds));
      if (Math.abs(app.timeOf(asked.frame) - seconds) > head.dt_s) {
        asked.amiss.push(`The link names the time ${seconds} s; the run is from ${from} s to ${to} s, so this is its nearest moment.`);
      }
    }
  }
  return asked;
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
  byId('notices').hidden = !head.notices.length;
  byId('notices').append(...head.notices.map((words) => element('div', { textContent: words })));
  Object.assign(byId('scrub'), { min: String(app.startS), max: String(app.endS), step: String(head.dt_s) });
  byId('speed').append(...SPEEDS.map((speed) => element('option', { value: String(speed), textContent: `${speed}\u00d7` })));
  byId('ego').append(element('option', { value: '-1', textContent: 'none' }),
    ...head.vehicles.map(({ id }, i) => element('option', { value: String(i), textContent: shortened(id, 48) })));
  byId('help').append(...KEYS.map(([key, words]) => element('span', {}, [element('kbd', { textContent: key }), ` ${words}`])));
}

start();
