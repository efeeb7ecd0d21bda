// Keys and pointer.

const KEYS = [
  ['Space', 'play or pause'], ['\u2190 \u2192', 'a step of 0.1 s; with Shift 1 s'],
  ['Home, End', 'first and last moment'], ['Page Up, Page Down', 'alert or event before and after'],
  ['+ \u2212', 'zoom'], ['F', 'follow the ego'], ['A', 'show everything'], ['T', 'light or dark'],
  ['[ ]', 'slower and faster'], ['N, P', 'next and previous vehicle as ego'],
];

function bindKeys({ app, step, seek, jumpToMoment, nextEgo, setSpeed, ...actions }) {
  const faster = (by) => setSpeed(SPEEDS[Math.min(Math.max(SPEEDS.indexOf(app.speed) + by, 0), SPEEDS.length - 1)]);
  const keys = {
    ' ': actions.play, ArrowLeft: (shift) => step(shift ? -10 : -1), ArrowRight: (shift) => step(shift ? 10 : 1),
    Home: () => step(-Infinity), End: () => step(Infinity), PageUp: () => jumpToMoment(-1), PageDown: () => jumpToMoment(1),
    '+': actions.closer, '=': actions.closer, '-': actions.farther, f: actions.follow, a: actions.whole,
    t: actions.theme, '[': () => faster(-1), ']': () => faster(1), n: () => nextEgo(1), p: () => nextEgo(-1),
  };
  window.addEventListener('keydown', (event) => {
    const busy = event.target.closest('select, input, textarea, summary');
    const pressing = event.key === ' ' && event.target.closest('button');
    if (busy || pressing || event.ctrlKey || event.metaKey || event.altKey) return;
    const action = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    event.preventDefault();
    action(event.shiftKey);
  });
}

// Drag to move, wheel or two fingers to zoom, a click chooses the vehicle there.
function bindPointer(canvas, app, redraw, letGo) {
  const fingers = new Map();
  let moved = 0, apart = 0;
  const spread = () => {
    const [a, b] = [...fingers.values()];
    return { apart: Math.hypot(a.x - b.x, a.y - b.y), x: (a.x + b.x) / 2, y: (a.y + b.y) / 2 };
  };
  const under = (x, y) => {
    const view = viewOf(app);
    let best = -1, least = Math.max(14 / app.camera.scale, 2.5);
    if (!view) return best;
    const [mapX, mapY] = app.camera.toMap(x, y);
    for (const state of view.states.values()) {
      const away = Math.hypot(state.x - mapX, state.y - mapY)
        - app.head.vehicles[state.vehicle].length_m / 4;
      if (away < least) { least = away; best = state.vehicle; }
    }
    return best;
  };
  canvas.addEventListener('pointerdown', (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, { x: event.offsetX, y: event.offsetY });
    moved = 0;
    if (fingers.size === 2) apart = spread().apart;
  });
  canvas.addEventListener('pointermove', (event) => {
    const finger = fingers.get(event.pointerId);
    if (!finger) {
      const pointed = under(event.offsetX, event.offsetY);
      canvas.style.cursor = pointed >= 0 ? 'pointer' : 'grab';
      if (pointed !== app.pointed) { app.pointed = pointed; redraw(); }
      return;
    }
    const dx = event.offsetX - finger.x, dy = event.offsetY - finger.y;
    Object.assign(finger, { x: event.offsetX, y: event.offsetY });
    moved += Math.hypot(dx, dy);
    if (moved < 4) return;
    letGo();
    app.camera.pan(dx / fingers.size, dy / fingers.size);
    if (fingers.size === 2) {
      const now = spread();
      app.camera.zoom(now.apart / Math.max(apart, 1), now.x, now.y);
      apart = now.apart;
    }
    redraw();
  });
  const lift = (event) => {
    if (fingers.delete(event.pointerId) && moved < 4 && event.type === 'pointerup') {
      const vehicle = under(event.offsetX, event.offsetY);
      if (vehicle >= 0) app.choose(vehicle);
    }
  };
  canvas.addEventListener('pointerup', lift);
  canvas.addEventListener('pointercancel', lift);
  canvas.addEventListener('wheel', (event) => {
    event.preventDefault();
    const pixels = event.deltaY * (event.deltaMode === 1 ? 16 : 1);
    app.camera.zoom(Math.exp(-0.0015 * pixels), event.offsetX, event.offsetY);
    redraw();
  }, { passive: false });
}
